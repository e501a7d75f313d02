"""The picture that the benchmarks have in common."""

from matplotlib.figure import Figure


def error_over_time(path, rows, case, line, error, label, columns=4, titles=None):
    """Errors over CPU time: a panel for each value of column `case`, a line for each of column `line`.

    Lines that took no time are levels, drawn across. `error` and `label` (of the axis) are names by case.
    """
    cases, lines = (list(dict.fromkeys(row[key] for row in rows)) for key in (case, line))
    columns = min(columns, len(cases))
    height = -(-len(cases) // columns)
    figure = Figure(figsize=(4.0 * columns, 3.8 * height), layout="constrained")
    panels = figure.subplots(height, columns, squeeze=False).ravel()
    for ax, name in zip(panels, cases):
        for code in lines:
            own = [r for r in rows if (r[case], r[line]) == (name, code) and r[error[name]] > 0]
            seconds, errors = [r["cpu_s"] for r in own], [r[error[name]] for r in own]
            if own and not any(seconds):
                ax.axhline(errors[0], color="0.5", lw=1, label=code)
            else:
                ax.loglog(seconds, errors, "o-", label=code)
        title = titles[name] if titles else name
        ax.set(title=title, xlabel="CPU time in s", ylabel=label[name], xscale="log", yscale="log")
        ax.grid(alpha=0.3)
    for ax in panels[len(cases) :]:
        ax.set_axis_off()
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    figure.savefig(path, dpi=130)
