"""Step 2: the calibration's file as a form; a change is written at once, a mistake is told beside it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from nicegui import ui

from calstudy.errors import CalstudyError
from calstudy.models.find import BESIDE, fidelities, shipped_models
from calstudy.models.photograph.photographs import target_text
from calstudy.study.definition import example, example_of
from calstudy.study.definition.models import Chosen, chosen_models
from calstudy.study.definition.typical import Typical, interval_for, typical
from calstudy.study.run.project import Project
from calstudy.tomlfile import Keys, read_toml, toml_of

PROCEDURE = {
    "seed": "seed",
    "WRL": "WRL, weight of a large time-step",
    "budget": "budget, most further runs",
    "confirm": "confirm, runs at the optimum",
    "until": "until, wanted probability",
}
TARGET = {"value": "measured", "sd": "its error (sd)", "tolerance": "tolerance"}
ANGLE, FLANK = "angle_of_repose_deg", "angle_of_repose_flank_deg"
NONE = "no material"


def number_of(text: str) -> str:
    """What was typed, as TOML: a number, or else a text, which the file's validation judges."""
    for kind in (int, float):
        try:
            return toml_of(kind(text))
        except ValueError:
            continue
    return toml_of(text)


class Material:
    """Step 2."""

    def __init__(self, project: Project) -> None:
        self.project, self.typical, self.material = project, typical(), "glass beads"
        self.fields: dict[Keys, Any] = {}
        self.chosen: tuple[Chosen, ...] = ()
        self.text: str | None = None
        self.shape: object = None
        self.form = ui.column().classes("part")
        self.general = ui.label().classes("wrong").props('role="alert"')
        with ui.expansion("The file itself").classes("part"):
            self.raw = ui.textarea().props('outlined autogrow aria-label="the file"').classes("part code")
            self.raw.on("change", lambda: self.do(lambda: project.write(self.raw.value)))

    # ---- what is on disk ---------------------------------------------------------------------------

    def look(self) -> None:
        """Show the file as it is now, whoever changed it."""
        try:
            text = self.project.text
        except CalstudyError as error:
            self.general.text = str(error)
            return
        if text == self.text:
            return
        self.text = self.raw.value = text
        content = self.project.content
        try:
            top, places = read_toml(self.project.file), (*self.project.models, *self.places)
            self.chosen = chosen_models(top, places, insist=True)
        except CalstudyError:
            pass  # the form of the last one stays; the mistake is told below
        shape = (bool(text), _shape(content), tuple(self.names("parameters")), tuple(self.names("responses")))
        if shape != self.shape:
            self.shape = shape
            self.build(content)
        for keys, field in self.fields.items():
            field.value = _shown(content, keys)
        self.tell()

    @property
    def places(self) -> Sequence[Any]:
        """Where the models of one's own are looked for."""
        return (self.project.directory, self.project.directory / BESIDE)

    def names(self, of: str) -> dict[str, str]:
        """Units of the models' ``parameters`` or ``responses``, by name."""
        return {name: unit for chosen in self.chosen for name, unit in getattr(chosen, of).items()}

    def tell(self) -> None:
        """Each mistake beside its field; those of no field below."""
        found = self.project.mistakes([*self.fields]) if self.text else {}
        for keys, field in self.fields.items():
            field.error = found.get(keys)
        self.general.text = found.get((), "")

    def do(self, change: Callable[[], None]) -> None:
        """Change the file, and show what it says then."""
        try:
            change()
        except CalstudyError as error:
            ui.notify(str(error), type="negative")
        self.look()

    def set(self, keys: Keys, value: str | None) -> None:
        """Write one value, or remove it."""
        self.do(lambda: self.project.set(keys, value))

    def take_angle(self, mean: float, sd: float) -> None:
        """Take an angle by the flanks as a target, in the place of the one by Appendix A."""
        if not self.project.file.exists():
            self.do(lambda: self.project.write(example()))
        for chosen in self.chosen:
            if (old := f"{chosen.prefix}{ANGLE}") in chosen.responses:
                self.set(("targets", f"{chosen.prefix}{FLANK}"), target_text(mean, sd))
                self.set(("targets", old), None)
                return
        ui.notify("No test of the file leaves a heap.", type="warning")

    # ---- the form ----------------------------------------------------------------------------------

    def build(self, content: Mapping[str, Any]) -> None:
        """Build the form anew."""
        self.fields.clear()
        self.form.clear()
        with self.form:
            if not self.text:
                self.begin()
                return
            options = [*self.typical, NONE]
            ui.select(options, value=self.material, label="Typical values of", on_change=self.choose).classes(
                "short"
            )
            self.tests(content)
            ui.label("Parameters").classes("heading")
            ui.label("Calibrated ones have an interval, the others a value. SI units.").classes("note")
            for name, unit in self.names("parameters").items():
                self.parameter(name, unit, content.get("parameters", {}).get(name))
            ui.label("What was measured").classes("heading")
            ui.label(
                "The error is the standard deviation of the measured value; give it for all, or for none."
            ).classes("note")
            for name, unit in self.names("responses").items():
                self.target(name, unit, content.get("targets", {}).get(name))
            ui.label("Procedure").classes("heading")
            with ui.element("div").classes("fields"):
                for name, label in PROCEDURE.items():
                    self.field((name,), label, partial(self.number, (name,)))

    def number(self, keys: Keys, text: str) -> None:
        """Write a number, or remove it."""
        self.set(keys, number_of(text) if text or keys[0] == "parameters" else None)

    def begin(self) -> None:
        """Choose the tests of a new file."""
        ui.label("Which tests did you make?").classes("heading")
        boxes = {name: ui.checkbox(name, value=name == "angle_of_repose") for name in shipped_models()}

        def write() -> None:
            chosen = [name for name, box in boxes.items() if box.value]
            self.project.write(example() if chosen == ["angle_of_repose"] else example_of(chosen))

        ui.button(f"Write {self.project.file.name}", on_click=lambda: self.do(write)).props("no-caps")

    def choose(self, event: Any) -> None:
        """Show the typical values of another material."""
        self.material, self.shape, self.text = event.value, None, None
        self.look()

    def tests(self, content: Mapping[str, Any]) -> None:
        """The models, with their fidelities."""
        ui.label("Tests").classes("heading")
        with ui.element("div").classes("fields"):
            for k, model in enumerate(content.get("models", [])):
                there = fidelities(str(model.get("name")), (*self.project.models, *self.places))
                if there and "fidelity" in model:
                    keys: Keys = ("models", k, "fidelity")
                    select = ui.select(list(there), label=f"{model['name']}: fidelity", new_value_mode="add")
                    select.props("outlined dense")
                    select.on(
                        "update:model-value", lambda _, s=select, keys=keys: self.set(keys, toml_of(s.value))
                    )
                    self.fields[keys] = select
                else:
                    ui.label(str(model.get("name")))

    def field(self, keys: Keys, label: str, write: Callable[[str], None], hint: str = "") -> None:
        """A field that is written when it is left."""
        made = ui.input(label).props(f'outlined dense hide-bottom-space hint="{hint}"')
        made.on("change", lambda: write(str(made.value or "").strip()))
        self.fields[keys] = made

    def parameter(self, name: str, unit: str, given: Any) -> None:
        """An interval, a value, or anything else that the file may say, as it is written there."""
        keys: Keys = ("parameters", name)
        is_interval, source = _is_interval(given), self.typical.get(self.material, {}).get(name)
        with ui.element("div").classes("row-of"):
            with ui.element("div").classes("named"):
                ui.label(f"{name}{'' if unit == '-' else f', {unit}'}")
                if is_interval or isinstance(given, int | float):
                    switch = ui.switch("calibrate", value=is_interval)
                    switch.on_value_change(lambda e: self.set(keys, self.other(name, given, source, e.value)))
            with ui.element("div").classes("fields"):
                if is_interval:
                    for k, label in enumerate(("from", "to")):
                        self.field((*keys, k), label, partial(self.end, keys, k))
                elif isinstance(given, int | float) or given is None:
                    self.field(keys, "value", partial(self.number, keys))
                else:
                    self.field(keys, "as in the file", lambda text: self.set(keys, text or '""'))
            ui.label(str(source or "")).classes("note")

    def other(self, name: str, given: Any, source: Typical | None, calibrated: bool) -> str:
        """An interval in place of a value, or a value in place of an interval."""
        if not calibrated:
            return toml_of((float(given[0]) + float(given[1])) / 2)
        return toml_of(interval_for(float(given), source))

    def end(self, keys: Keys, k: int, text: str) -> None:
        """Write one end of an interval; the other one stays as it is in the file."""
        ends = [toml_of(end) for end in self.project.content["parameters"][keys[1]]]
        ends[k] = number_of(text)
        self.set(keys, f"[{', '.join(ends)}]")

    def target(self, name: str, unit: str, given: Any) -> None:
        """Value, error and tolerance of a response, or that it was not measured."""
        keys: Keys = ("targets", name)
        source = self.typical.get(self.material, {}).get(name)
        plain = not isinstance(given, Mapping) or "value" in given
        with ui.element("div").classes("row-of"):
            with ui.element("div").classes("named"):
                switch = ui.switch(f"{name}{'' if unit == '-' else f', {unit}'}", value=given is not None)
                switch.on_value_change(lambda e: self.set(keys, '{ value = "" }' if e.value else None))
            with ui.element("div").classes("fields"):
                for key, label in TARGET.items() if given is not None and plain else ():
                    self.field((*keys, key), label, partial(self.part, keys, key))
                if not plain:
                    self.field(keys, "as in the file", lambda text: self.set(keys, text or '""'))
            ui.label(str(source or "")).classes("note")

    def part(self, keys: Keys, key: str, text: str) -> None:
        """Write one number of a target; the others stay."""
        given = self.project.content["targets"].get(keys[1])
        parts = (
            {k: toml_of(v) for k, v in given.items()}
            if isinstance(given, dict)
            else {"value": toml_of(given)}
        )
        if text or key == "value":
            parts[key] = number_of(text)
        else:
            parts.pop(key, None)
        self.set(keys, "{ " + ", ".join(f"{k} = {v}" for k, v in parts.items()) + " }")


def _is_interval(given: Any) -> bool:
    return isinstance(given, list) and len(given) == 2


def _shape(content: Mapping[str, Any]) -> object:
    """What decides which fields there are."""
    parameters = {
        name: "interval" if _is_interval(given) else "value" if isinstance(given, int | float) else "other"
        for name, given in content.get("parameters", {}).items()
    }
    targets = {n: not isinstance(t, Mapping) or "value" in t for n, t in content.get("targets", {}).items()}
    return parameters, targets, [model.get("name") for model in content.get("models", [])]


def _shown(content: Mapping[str, Any], keys: Keys) -> Any:
    """What a field shows of a value: a number as it is written, a text without quotes."""
    at: Any = content
    for key in keys:
        if key == "value" and not isinstance(at, Mapping):
            return _shown({"value": at}, ("value",))
        try:
            at = at[key]
        except (KeyError, IndexError, TypeError):
            return ""
    return at if isinstance(at, str) else f"{at:.10g}" if isinstance(at, float) else toml_of(at)
