"""Read many mutants of every seed, and print the escapes.

python -m tests.fuzz [--count 100000] [--first 0] [--seeds pocket.ngc ...] [--out DIR]

The mutants of an escape are written to the folder; the command ends with 1 if there is
one.
"""

import argparse
import pathlib
import resource
import sys
import tempfile
import time

import jax

from .readers import READERS, copy_seeds, escape_of, mutant_of, shares_of

# Memory of the process [byte]: a file that takes more ends in a MemoryError.
_MEMORY = 16 * 2**30


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("--count", type=int, default=100_000, help="mutants in all")
    parser.add_argument("--first", type=int, default=0, help="number of the first")
    parser.add_argument("--seeds", nargs="*", choices=READERS, default=list(READERS))
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("out/fuzz"))
    asked = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    found = 0
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        copy_seeds(folder)
        for seed, each in shares_of(asked.count, asked.seeds).items():
            begin, known = time.perf_counter(), set[str]()
            for number in range(asked.first, asked.first + each):
                escape = escape_of(seed, number, folder)
                if escape is None:
                    continue
                found += 1
                # One of each kind in full.
                place = escape.trace.splitlines()[-2:-1]
                kind = escape.what.split(":")[0] + "".join(place)
                if kind in known:
                    continue
                known.add(kind)
                asked.out.mkdir(parents=True, exist_ok=True)
                (asked.out / f"{number}-{seed}").write_bytes(mutant_of(seed, number))
                print(f"ESCAPE {seed} {number}: {escape.what}\n{escape.trace}")
            took = time.perf_counter() - begin
            print(f"{seed}: {each} mutants, {took:.0f} s", flush=True)
    print(f"{found} escapes")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
