"""The table of commands and functions in python/README.md: a row for each command of the program."""

from __future__ import annotations

import inspect
import re
import subprocess

from conftest import ROOT

import pwrfgs

# Function of each command, as it is called, and the returned value; a reason alone for a command without a function.
FUNCTIONS = {
    "run": ("pwrfgs.run(pipeline)", "`Run`: scores, training curve, model"),
    "pipelines": ('pwrfgs.Pipeline("quickstart")', "`Pipeline`: settings as attributes"),
    "check": ("pwrfgs.check(pipeline)", "`Check`: memory, time, warnings"),
    "sweep": ('pwrfgs.sweep(pipeline, axes={"training.scale": [0.1, 0.5]})', "list of `Run`"),
    "compare": ("pwrfgs.compare(data)", "`Comparison`: scores of all methods and baselines"),
    "predict": ("model.predict(tx)", "array; `Interval` with `interval=0.9`; iterator of arrays with `batch_size=`"),
    "map": ('model.map(plane="z=1.2", step=0.25)', "`RadioMap`: layers [rows, columns] with units"),
    "locate": ("model.locate(observations)", "`Located`: positions [B, 3]; without observations, errors on the test set"),
    "plan": ("pwrfgs.plan(data, candidates=positions)", "`Plan`: positions to measure next, in order"),
    "place": ('pwrfgs.place("office", count=1)', "`Placement`: receiver positions and their coverage"),
    "view": ("run.view()", "`View`: page in a notebook, or the address of this page"),
    "evaluate": ("pwrfgs.evaluate(model, pipeline)", "`Run`: scores and report, also of your own model"),
    "report": ("pwrfgs.report(runs)", "tables as text; the report folder has the figures"),
    "update": ("model.update(data)", "`Model` with new measurements in its Kriged residuals, without training"),
    "compress": ("model.compress(bits=8)", "`Model` with weights in 8 or 16 bits"),
    "export": ("model.gaussians()", "`Gaussians`: arrays; `model.to_ply(path)` writes a file for splat viewers"),
    "import": ("pwrfgs.Dataset.from_table(frame)", "`Dataset`"),
    "simulate": ('pwrfgs.simulate("office", "data/office")', "`Dataset`, also written to the folder"),
    "export-scene": ('pwrfgs.convert.to_sionna("office", "office-xml")', "number of meshes written to the folder"),
    "plugins": ("help(pwrfgs.LearnableMask)", "documentation of a plugin"),
    "data": ("pwrfgs.Dataset.load(path)", "`Dataset`"),
    "devices": ("pwrfgs.devices()", 'names of the GPUs; `pwrfgs.use_device("gpu")` selects one for this process'),
    "inspect": ("pwrfgs.inspect(data)", "`Inspection`: positions, values, splits, baselines"),
    "init": ("pwrfgs.Pipeline.for_data(data)", "`Pipeline` for your data"),
    "completions": "completes commands in a shell",
    "man": "writes manual pages of the program",
}


def table(commands):
    """Rows of the table, in the order of the program's help."""
    rows = ["| command | function | returned value |", "|---|---|---|"]
    for command in commands:
        entry = FUNCTIONS[command]
        call, back = (f"`{entry[0]}`", entry[1]) if isinstance(entry, tuple) else ("none", entry)
        rows.append(f"| `{command}` | {call} | {back} |")
    return "\n".join(rows) + "\n"


def test_table_has_a_row_per_command(cli):
    shown = subprocess.run([cli, "--help"], capture_output=True, text=True, check=True).stdout
    commands = re.findall(r"^  ([a-z-]+) {2,}[A-Z]", shown.split("Commands:")[1].split("Options:")[0], flags=re.MULTILINE)
    assert [command for command in commands if command != "help"] == list(FUNCTIONS)
    wanted = table(FUNCTIONS)
    assert wanted in (ROOT / "python/README.md").read_text(encoding="utf-8"), f"python/README.md lacks this table:\n{wanted}"


def test_functions_are_there_and_return_what_the_table_names():
    names = {"pwrfgs": pwrfgs, "model": pwrfgs.Model, "run": pwrfgs.Run}
    for command, entry in FUNCTIONS.items():
        if not isinstance(entry, tuple) or entry[0].startswith("help"):
            continue
        call, back = entry
        function = eval(call.split("(")[0], names)
        assert callable(function) and inspect.getdoc(function), command
        for name in re.findall(r"`([A-Z]\w+)`", back):
            assert isinstance(getattr(pwrfgs, name), type), (command, name)
