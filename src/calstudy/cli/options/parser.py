"""The parser of the command line, which declares a command's options when it is asked for."""

from __future__ import annotations

import itertools
import re
import sys
from argparse import ArgumentParser, _SubParsersAction
from importlib import import_module

from calstudy.written import choice


class Parser(ArgumentParser):
    """Says what is wrong with the command line in one line; abbreviations of options are not taken."""

    verbs: _SubParsersAction[Parser] | None = None
    command: str = ""
    """``module.function`` in calstudy.cli; ``function_options`` in calstudy.cli.options.module declares
    its options."""

    def declare(self) -> None:
        """Declare the options of the command, once; what it works with is not imported."""
        if self.command and self.get_default("command") is None:
            module, _, function = self.command.partition(".")
            room = import_module(f"calstudy.cli.options.{module}")
            getattr(room, f"{function}_options")(self)
            self.set_defaults(command=self.command)

    def parse_known_args(self, args=None, namespace=None):  # type: ignore[no-untyped-def]
        """As argparse does, once every word that it would not know has been looked at."""
        self.declare()
        words = list(sys.argv[1:] if args is None else args)
        verb = next((word for word in words if not word.startswith("-")), None) if self.verbs else None
        known = [name for name in self._option_string_actions if name.startswith("--")]
        for word in itertools.takewhile(lambda word: word not in ("--", verb), words):
            option = word.partition("=")[0]
            if re.fullmatch("--[a-z-]+", option) and option not in known:
                self.error(f"there is no option {option}; {choice(option, known, 'there are')}")
        if self.verbs and verb and verb not in self.verbs.choices:
            self.error(f"there is no command {verb!r}; {choice(verb, self.verbs.choices, 'there are')}")
        return super().parse_known_args(words, namespace)

    def error(self, message: str) -> None:  # type: ignore[override]
        """End with exit code 2 and one line."""
        self.exit(2, f"{self.prog}: {message} (see '{self.prog} --help')\n")
