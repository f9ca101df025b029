"""The diagrams as an offline page to look into: every point tells its setting, error, time and work."""

from __future__ import annotations

from typing import Any

from flexfmu.cosim.workprec.conclusions import sentence
from flexfmu.cosim.workprec.figures import FLOOR, TITLES, lines_of
from flexfmu.cosim.workprec.study import FAMILIES, Study


def html(study: Study) -> str:
    """The page; the drawing library is inside, nothing is fetched."""
    import plotly.io as pio

    names = [name for name in FAMILIES if study.family(name)]
    parts = [
        pio.to_html(_figure(study, name), include_plotlyjs=i == 0, full_html=False) for i, name in enumerate(names)
    ]
    title = f"Work and precision: {study.scene.name}"
    head = f'<meta charset="utf-8"><title>{title}</title><style>body{{font-family:sans-serif;margin:2rem}}</style>'
    return f"<!doctype html><html lang=en><head>{head}</head><body><h1>{title}</h1><p>{sentence(study)}</p>{''.join(parts)}</body></html>"


def _figure(study: Study, name: str) -> Any:
    import plotly.graph_objects as go

    figure = go.Figure()
    for line, trials in lines_of(study, name).items():
        good = [each for each in trials if not each.failed]
        figure.add_scatter(
            x=[max(each.error or 0.0, FLOOR) for each in good],
            y=[1e3 * (each.time or 0.0) for each in good],
            text=[each.label for each in good],
            customdata=[[study.duration / (each.time or 1.0), each.note] for each in good],
            hovertemplate="%{text}: error %{x:.2e}, %{y:.3g} ms, %{customdata[0]:.3g} x real time<br>%{customdata[1]}",
            mode="lines+markers",
            name=line,
        )
        failed = [each for each in trials if each.failed]
        if failed:
            figure.add_scatter(
                x=[1.0] * len(failed),
                y=[1e3 * study.duration] * len(failed),
                text=[f"{each.label}: {each.note}" for each in failed],
                hovertemplate="failed: %{text}",
                mode="markers",
                marker={"symbol": "x"},
                name=f"{line}, failed",
            )
    axes = {"xaxis_title": "error, relative to what elasticity does", "yaxis_title": "time [ms]"}
    figure.update_layout(title=TITLES[name], xaxis_type="log", yaxis_type="log", template="plotly_white", **axes)
    figure.update_xaxes(exponentformat="e", dtick=1)
    return figure
