"""A DEM model of your own: a folder with an input script, the files that it needs, and a model.toml.

model.toml says how parameters reach the script, which responses it gives and where each is read, and what the
Rayleigh time-step is computed from where it is needed; docs/reference/model-toml.md explains each key. The
folder is copied for every run, so what is read afterwards was written by that run. Outputs that lie in the
folder are refused.
"""

from calstudy.models.folder.content import NAME
from calstudy.models.folder.file import load_folder
from calstudy.models.folder.model import FolderModel

__all__ = ["NAME", "FolderModel", "load_folder"]
