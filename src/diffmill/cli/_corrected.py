"""The corrected command as files: a path, programs, a stream of offsets."""

from typing import TYPE_CHECKING

import equinox as eqx
import numpy as np
from jaxtyping import Float

if TYPE_CHECKING:
    from .._job import Job


def corrected_files(
    job: "Job", commanded: Float[np.ndarray, "step 3"]
) -> tuple[dict[str, str], list[str]]:
    """Return the files of a corrected command by name, and lines about them.

    Args:
        job: The job.
        commanded: Tip positions of the corrected command [m], shape (step, 3).
    """
    from ..io import offset_stream, write_gcode, write_path_csv, write_program
    from ..toolpath import reduce_path

    output, said = job.output, []
    path = eqx.tree_at(lambda p: p.positions, job.path, commanded)
    files = {"corrected.csv": write_path_csv(path)}
    blocks = reduce_path(path, output.tolerance)
    header = [f"{job.name}, corrected by diffmill", f"method: {job.correction.method}"]
    for suffix in output.formats:
        name = f"corrected{suffix}"
        if suffix == ".ngc":
            speed = float(job.spindle_speed)
            files[name] = write_gcode(blocks, header=header, spindle_speed=speed)
        else:
            files[name] = write_program(blocks, suffix, header=header)
        said.append(
            f"{name}: {blocks.step_count - 1} blocks instead of "
            f"{path.step_count - 1}, within {output.tolerance * 1e6:g} um at any time"
        )
    if output.cycle > 0:
        stream = offset_stream(job.path, path, output.cycle)
        files["stream.csv"] = stream.text
        line = f"stream.csv: steps of {stream.largest_step * 1e6:.3g} um at most"
        if stream.largest_step > output.max_step:
            line += f", but [output] max_step is {output.max_step * 1e6:g} um"
        said.append(line)
    return files, said
