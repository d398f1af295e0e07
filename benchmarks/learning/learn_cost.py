"""Time a round of learning, with meshes, vertices and joints each doubled: `python -m benchmarks.learn_cost`.

    python -m benchmarks.learn_cost --vertices 700 --meshes 10 --joints 6

The embedded human under swing-twist skinning, as in `learn_known`. A round is each improvement once: weights,
vertices, joints with all poses. The first round compiles, and is left out with all that comes before it.
Run it with nothing else beside. The table in Markdown goes to standard error, and to `--output`.
"""

import argparse
from pathlib import Path

import numpy as np

from benchmarks._scenes import shared_folder
from benchmarks.learning._learning import learn, make_synthetic_meshes
from benchmarks.report import finish, progress

#: rounds learned, on meshes that are not thinned and before joints are exchanged; the last ones are timed
ROUNDS = 3


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.learn_cost", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--meshes", type=int, default=30)
    parser.add_argument("--vertices", type=int, default=2000)
    parser.add_argument("--joints", type=int, default=12)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--output", type=Path, help="write the table to a Markdown file")
    options = parser.parse_args()
    base = (options.meshes, options.vertices, options.joints)

    cases = {"base": base}
    for axis, name in enumerate(("meshes", "vertices", "joints")):
        cases[name] = tuple(2 * size if axis == at else size for at, size in enumerate(base))
    lines = ["| meshes | vertices | joints | seconds per round | first round, including compilation |"]
    lines += ["|---|---|---|---|---|"]
    figures, sizes = {}, {}
    for name, (meshes, vertices, joints) in cases.items():
        scene = make_synthetic_meshes(shared_folder(), training=meshes, held_out=1, resolution=vertices)
        run = learn(scene.training, joints=joints, rounds=options.rounds)
        # a run that has nothing left to improve may stop after its first round
        later = float(np.median(run.rounds[1:])) if len(run.rounds) > 1 else float("nan")
        sizes[name] = {"meshes": meshes, "vertices": scene.clean.shape[1], "joints": joints}
        figures |= {f"{name}_seconds_a_round": later, f"{name}_first_seconds": run.rounds[0]}
        if name != "base":
            figures[f"{name}_doubled_times"] = later / figures["base_seconds_a_round"]
        lines += [f"| {meshes} | {scene.clean.shape[1]:,} | {joints} | {later:.2f} | {run.rounds[0]:.1f} |"]
        progress(lines[-1])
    table = "\n".join(lines) + "\n"
    progress(table)
    if options.output:
        options.output.write_text(table)
    finish("learn_cost", figures, sizes=sizes)


if __name__ == "__main__":
    main()
