"""Run folders with changed records: `python mutated_runs.py [SECONDS] [SEED]`.

It makes a run, changes one of its records by bytes, tokens or lines that a seed draws, and reads the folder as `open_run`, `statistics` and
`report` do. Each change must end in results or in an error of the package. A panic, another exception, a file outside the run or more than
`MEMORY_MB` is an exit code of 1. At the end it prints, of each record, how often it was changed and how often the page was written.
"""

import gzip
import json
import os
import random
import re
import resource
import sys
import tempfile
import time
from pathlib import Path

import planagent
from planagent import errors

#: What the process may take, MB.
MEMORY_MB = 1000
#: Values that no simulation gives.
WILD = [
    *(b"nan", b"inf", b"-inf", b"1e308", b"-1e308", b"1e-320", b"0", b"-1", b"1000000", b"0.1"),
    *(b"9223372036854775807", b"-9223372036854775808", b"18446744073709551616", b"true", b"null"),
    *(b'""', b'"../../x"', b'"\\u202e\\u0007"', b'"a\\u0000"', b"[]", b"{}", b"[[[[]]]]"),
]
#: Numbers, texts and words of TOML and JSON.
TOKEN = re.compile(rb'-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?|"[^"\n]{0,80}"|true|false|null')


def changed(record: bytes, drawn: random.Random) -> bytes:
    """A record with one to four changes."""
    for _ in range(drawn.choice((1, 1, 1, 2, 4))):
        kind, at = drawn.randrange(9), drawn.randrange(max(1, len(record)))
        lines = record.split(b"\n")
        first, second = drawn.randrange(len(lines)), drawn.randrange(len(lines))
        tokens = [match.span() for match in TOKEN.finditer(record)]
        if kind < 4 and tokens:
            begin, end = drawn.choice(tokens)
            record = record[:begin] + drawn.choice(WILD) + record[end:]
        elif kind == 4:
            record = record[:at] + bytes([drawn.randrange(256)]) + record[at + 1 :]
        elif kind == 5:
            record = record[:at] + record[at + drawn.choice((1, 2, 8, 100)) :]
        elif kind == 6:
            record = record[:at] + record[at : at + drawn.choice((1, 8, 64, 500))] * drawn.choice((2, 50)) + record[at:]
        elif kind == 7:
            lines[first], lines[second] = lines[second], lines[first]
            record = b"\n".join(lines)
        else:
            lines.insert(first, lines[second])
            record = b"\n".join(lines)
    return record


def whole_run(folder: Path) -> dict[str, Path]:
    """A run with planning calls in a folder; the paths of its records."""
    planagent.simulate("generated/changing_lane/2", "plan-agent", out=folder)
    simulation = next((folder / "simulations").iterdir())
    record = simulation / "record.toml"
    # Without digests, changed files are read. Lists of times would take most of the changes.
    text = re.sub(r'\[files\]\n(".*\n)+', "", record.read_text())
    record.write_text(re.sub(r"planner_s = \[.*\]", "planner_s = [0.1, 0.2]", text))
    calls = simulation / "calls.jsonl"
    calls.write_text("".join(calls.read_text().splitlines(keepends=True)[:2]))
    names = ("record.toml", "metrics.toml", "calls.jsonl", "replay.json.gz")
    return {"manifest.toml": folder / "manifest.toml", **{name: simulation / name for name in names}}


def main() -> int:
    seconds, seed = float((sys.argv[1:] or ["20"])[0]), int((sys.argv[2:] or ["0"])[0])
    drawn = random.Random(seed)
    with tempfile.TemporaryDirectory() as work:
        run = Path(work, "run")
        records = whole_run(run)
        originals = {name: path.read_bytes() for name, path in records.items()}
        counts = {name: {"changed": 0, "pages": 0} for name in records}
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            name = drawn.choice(list(records))
            original = originals[name]
            if name.endswith(".gz"):
                record = gzip.compress(changed(gzip.decompress(original), drawn), 1)
            else:
                record = changed(original, drawn)
            records[name].write_bytes(record)
            counts[name]["changed"] += 1
            try:
                results = planagent.open_run(run)
                repr(results), results.table().to_dict(), results.statistics()
                results.report(Path(work, "page.html"))
                counts[name]["pages"] += 1
            except errors.InternalError as error:
                print(f"seed {seed}, {name}: {error}")
                Path(f"broken-{name}").write_bytes(record)
                return 1
            except errors.PlanAgentError:
                pass
            records[name].write_bytes(original)
        outside = set(os.listdir(work)) - {"run", "page.html"}
        memory_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
        print(json.dumps({"seconds": seconds, "seed": seed, "memory_mb": memory_mb, "records": counts}))
        return int(bool(outside) or memory_mb > MEMORY_MB)


if __name__ == "__main__":
    sys.exit(main())
