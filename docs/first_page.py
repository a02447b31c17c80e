"""The README's picture, docs/static/report_first_page.png: the first page of the report.

``make screenshot`` analyses the bundled campaign into build/demo, unless the report is there, and
takes the picture with a headless Chromium.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
REPORT = ROOT / "build" / "demo" / "report.html"
PICTURE = ROOT / "docs" / "static" / "report_first_page.png"
SIZE = 1000, 1180
"""px, width and height: the answer, the chain and the overlay"""


def take(report: Path, picture: Path, browser: str) -> None:
    """Write the picture of the top of ``report``; CalledProcessError where the browser fails."""
    with tempfile.TemporaryDirectory() as profile:
        subprocess.run(
            [
                browser, "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run",
                "--disable-background-networking", "--disable-dev-shm-usage", "--hide-scrollbars",
                "--host-resolver-rules=MAP * ~NOTFOUND", f"--user-data-dir={profile}",
                f"--screenshot={picture}", f"--window-size={SIZE[0]},{SIZE[1]}", report.as_uri(),
            ],
            check=True, capture_output=True, timeout=120,
        )  # fmt: skip


def main() -> int:
    """Analyse if needed, take the picture, say where it is."""
    names = ("chromium", "chromium-browser", "google-chrome", "chrome")
    browser = next((path for name in names if (path := shutil.which(name))), None)
    if browser is None:
        print("the picture needs Chromium or Chrome; install one of them", file=sys.stderr)
        return 2
    report = Path(sys.argv[1]).resolve() if len(sys.argv) > 1 else REPORT
    if not report.is_file():
        campaign = ROOT / "data" / "reference" / "campaign.toml"
        command = [sys.executable, "-m", "bayes_sensor", "analyze", str(campaign)]
        subprocess.run([*command, "--out", str(report.parent)], check=True)
    take(report, PICTURE, browser)
    print(f"picture: {PICTURE}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
