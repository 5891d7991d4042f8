"""Files of installed packages that hold the descriptions of hands and arms, found without importing the package."""

from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from dexnudge.errors import HandError


def package_file(package: str, end: str, *, what: str, install: str) -> Path:
    """Return the file of an installed package whose path ends in `end`.

    Args:
        package: name of the distribution, as pip knows it.
        end: last parts of the path, separated by "/".
        what: what it describes, such as "hand 'leap'", for the message.
        install: what to type where the package is missing, for the message.

    Raises:
        HandError: the package is not installed, or has no such file.
    """
    try:
        files = distribution(package).files or []
    except PackageNotFoundError as error:
        raise HandError(
            f"the description of {what} is missing: expected the package {package}, found none; mend it with: {install}"
        ) from error
    found = [path for file in files if str(file).endswith(end) and (path := Path(str(file.locate()))).is_file()]
    if not found:
        raise HandError(
            f"the package {package} has no file {end}, which describes {what}: expected another version of the "
            f"package; mend it with: {install}"
        )
    return found[0]
