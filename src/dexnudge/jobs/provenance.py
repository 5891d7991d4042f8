"""What a number was made with: versions, machine, memory."""

import platform
import re
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from dexnudge.jobs.processes import available_cores
from dexnudge.version import __version__

RECORDED_VERSIONS = ("dexnudge", "numpy", "scipy", "trimesh", "torch", "warp-lang")


def versions() -> dict[str, str]:
    """Return versions of dexnudge, Python and the packages that figures depend on."""
    return {"python": platform.python_version(), **recorded_versions()}


def machine(device: str = "cpu") -> dict[str, str | int]:
    """Return processor, cores, system and compute device, as text for a report."""
    return {
        "processor": _processor(),
        "cores": available_cores(),
        "system": f"{platform.system()} {platform.machine()}",
        "device": device,
    }


KIBIBYTE = 1024  # bytes; Linux calls it kB


def peak_memory_mb() -> float:
    """Return the largest resident memory of this process so far [MB]; 0 where the system does not tell."""
    status = Path("/proc/self/status")  # Linux; getrusage there also counts what the process that started this one held
    if status.is_file() and (
        found := re.search(r"^VmHWM:\s+(\d+) kB", status.read_text(errors="replace"), re.MULTILINE)
    ):
        return int(found[1]) * KIBIBYTE / 1e6
    try:
        import resource
    except ImportError:  # Windows
        return 0.0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak * (1 if sys.platform == "darwin" else KIBIBYTE) / 1e6  # macOS counts bytes


def _processor() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        for line in cpuinfo.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or "unknown"


def recorded_versions() -> dict[str, str]:
    """Return versions of what decides the numbers; of dexnudge, that of the code which runs."""
    found = {}
    for package in RECORDED_VERSIONS:
        try:
            found[package] = __version__ if package == "dexnudge" else version(package)
        except PackageNotFoundError:
            continue
    return found
