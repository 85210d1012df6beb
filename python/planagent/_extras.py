"""Packages that only some functions need."""

from __future__ import annotations

import importlib
from typing import Any

from .errors import MissingPackageError

#: Packages by the extra of planagent that installs them.
EXTRAS = {"gymnasium": "gymnasium", "matplotlib": "plot", "pandas": "pandas", "pyarrow": "pandas", "ray": "ray"}
#: How to install what pip does not find.
NOT_ON_AN_INDEX = {"nuplan": "install nuplan-devkit from its sources, then pip install 'planagent[nuplan]'"}


def installed(module: str, needed_by: str) -> Any:
    """A module; an error says what to install."""
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        package = module.partition(".")[0]
        # What the package itself lacks is said as it is.
        if error.name is not None and error.name.partition(".")[0] != package:
            raise
        extra = EXTRAS.get(package)
        how = NOT_ON_AN_INDEX.get(package) or f"pip install 'planagent[{extra}]'" if extra else f"pip install {package}"
        raise MissingPackageError(f"{needed_by} needs {package}, which is not installed: {how}", name=package) from None
