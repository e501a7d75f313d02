"""Without torch or scipy, as in the second environment, tests that need them are not collected."""

from importlib.util import find_spec

NEED = {
    "torch": [
        "test_gnn_models.py",
        "test_gnn_optimizers.py",
        "test_gnn_rollout.py",
        "test_gnn_training.py",
        "test_gnn_demos.py",
    ],
    "scipy": ["test_gnn_hierarchy.py", "test_gnn_datasets.py", "test_gnn_datasets_solids.py"],
}
collect_ignore = [name for package, names in NEED.items() if find_spec(package) is None for name in names]
