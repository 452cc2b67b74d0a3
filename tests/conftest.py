"""Settings of all laws, and an environment without what would hide faults."""

import atexit
import os
import shutil
import tempfile

from hypothesis import HealthCheck, settings

# Programs that the tests start run as on a fresh machine: PYTHONUNBUFFERED hides what goes wrong in a buffer.
for name in list(os.environ):
    if name.startswith("PYTHON") or name in {"COLUMNS", "LINES", "NO_COLOR", "FORCE_COLOR"}:
        del os.environ[name]

# What the user has done before is not known here, and is not changed.
os.environ["XDG_STATE_HOME"] = tempfile.mkdtemp(prefix="state-")
atexit.register(shutil.rmtree, os.environ["XDG_STATE_HOME"], ignore_errors=True)

# A busy machine breaks no law, and every run tries the same examples.
settings.register_profile(
    "laws", deadline=None, derandomize=True, print_blob=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("laws")
