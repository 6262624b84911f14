"""Which programs made a result: versions, for result files and reports."""

from __future__ import annotations

import platform
from importlib import metadata


def program_version() -> str:
    """Return the installed version of tactilux, or say that it runs from bare sources."""
    try:
        return metadata.version("tactilux")
    except metadata.PackageNotFoundError:
        return "uninstalled sources"


def package_versions(*names: str) -> dict[str, str]:
    """Return the versions of Python and of the named packages, as far as they are installed."""
    found = {"tactilux": program_version(), "python": platform.python_version()}
    for name in names:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found
