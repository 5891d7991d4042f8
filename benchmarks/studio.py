"""The studio in a headless Chromium: its first frame, frames a second for one hand and for many, draw calls, triangles.

    python benchmarks/studio.py DIR [--angle gl|swiftshader]

Without a graphics card this measures software: compare with the line of viser's empty page, drawn by the same browser.
"""

import argparse
import platform
import time
from contextlib import closing

import viser
from browser import first_frame, frame_rate, opened_page

from dexnudge.jobs.provenance import machine, versions
from dexnudge.studio.studio import Studio

SETTLING = 3000  # [ms] until everything has been sent and drawn once
TRIANGLES = "window.__viserTestpoints.rendererInfo.render.triangles"


def empty_page(angle: str) -> None:
    """Print what viser's own page takes with a single triangle."""
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    server.scene.configure_environment_map(None)
    server.scene.configure_default_lights(cast_shadow=False)
    one = [[1.0, 0.0, 0.0, 0.0]]
    server.scene.add_batched_meshes_simple("/t", [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], one, [[0.0, 0.0, 0.0]])
    with opened_page(f"http://127.0.0.1:{server.get_port()}", angle=angle) as page:
        first = first_frame(page)
        page.wait_for_timeout(SETTLING)
        rate, calls = frame_rate(page)
    print(f"viser, one triangle: first frame {first:.1f} s; {rate:.1f} frames a second, {calls} draw calls")
    server.stop()


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", help="result folder")
    parser.add_argument("--angle", default="gl", help="what draws: gl (Mesa, or a graphics card), swiftshader")
    options = parser.parse_args()
    print(machine(), platform.platform(), {name: versions()[name] for name in ("dexnudge", "python")})
    empty_page(options.angle)
    start = time.perf_counter()
    with closing(Studio(options.folder, port=0)) as studio:
        print(f"studio ready after {time.perf_counter() - start:.1f} s")
        with opened_page(studio.url, angle=options.angle) as page:
            print(f"first frame {first_frame(page):.1f} s after the page was opened")
            for together in (False, True):
                with studio.session.lock:
                    studio.session.select(together=together)
                page.wait_for_timeout(SETTLING)
                hands = min(32, len(studio.session.samples)) if together else 1
                triangles = page.evaluate(TRIANGLES)
                rate, calls = frame_rate(page)
                print(f"{hands} hands: {rate:.1f} frames a second, {calls} draw calls, {triangles} triangles")


if __name__ == "__main__":
    main()
