"""The learned simulation: hierarchies, a training step, and errors of trained networks."""

from . import gnn_accuracy as accuracy
from .gnn_hierarchy import hierarchy_table
from .gnn_models import batch_memory_table, training_step_table


def gnn_benchmarks(folder, quick, table, write_csv):
    """All tables of the learned simulation: print them and write CSV files into a folder."""

    def show(name, title, rows):
        print(f"\n{title}", flush=True)
        print(table(rows), flush=True)
        write_csv(folder / f"gnn_{name}.csv", rows)

    show("hierarchy", "levels of a mesh, one thread, beside the authors' code", hierarchy_table(quick))
    show("step", "a training step by nodes (figure 4.10), one thread", training_step_table(quick))
    show("memory", "memory of a training step by the batch (table 4.6)", batch_memory_table(quick))
    data, test, out = folder / "cylinder", folder / "cylinder_test", folder / "gnn"
    minutes = 0.1 if quick else 6
    accuracy.make_data(data, 10 if quick else 50)
    accuracy.make_data(test, 2 if quick else 16, "--seed", "7")
    runs = accuracy.architectures(data, test, out, minutes, 1 if quick else 3)
    show("runs", f"after {minutes} minutes", runs)
    show("models", "means of these (table 4.5)", accuracy.means(runs, test))
    transitions = accuracy.transitions(data, test, out, minutes, runs[0])
    show("transitions", f"after {minutes} minutes (table 4.7)", transitions)
    if not quick:
        show("others", f"other sets after {minutes} minutes", accuracy.other_sets(folder, out, minutes))
    show("larger", "on finer meshes than those of the training", accuracy.larger_meshes(test, out, runs[0]))
    show("seeds", "other seeds than in the training (table 4.8)", accuracy.seeding(test, out, runs[0]))
