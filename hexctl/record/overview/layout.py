"""The layout that an overview opens with."""

from typing import Any

from hexctl.record import style
from hexctl.record.overview import paths
from hexctl.record.overview.above import picture, visible_m
from hexctl.record.overview.curve import score_top_m
from hexctl.record.overview.trials import Overview

#: Share of the curve's width that is kept free for its legend.
LEGEND_SHARE = 0.15


def make_layout(overview: Overview) -> Any:
    """Return the blueprint of an overview."""
    import rerun.blueprint as rrb

    left = rrb.Vertical(_above_view(overview), _curve_view(overview), row_shares=[5, 2])
    table = rrb.TextDocumentView(origin=paths.TABLE, name="trials")
    return rrb.Blueprint(
        rrb.Horizontal(left, table, column_shares=[5, 3]),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        # Following: the time cursor begins at the last trial, so that all are shown.
        rrb.TimePanel(state="collapsed", timeline=paths.TIMELINE, play_state="following", fps=4.0),
        auto_views=False,
        auto_layout=False,
    )


def _above_view(overview: Overview) -> Any:
    import rerun.blueprint as rrb

    (x_low, bottom), (x_high, top) = picture(visible_m(overview))
    return rrb.Spatial2DView(
        origin=paths.ABOVE,
        name="trajectories from above (m)",
        background=[*style.BACKGROUND],
        visual_bounds=rrb.VisualBounds2D(x_range=[x_low, x_high], y_range=[top, bottom]),
        overrides={path: rrb.EntityBehavior(interactive=False) for path in paths.SCENERY},
    )


def _curve_view(overview: Overview) -> Any:
    import rerun.blueprint as rrb

    first, last = overview.trials[0].index, overview.trials[-1].index
    # Room for the legend.
    last += max(1, round(LEGEND_SHARE * (last - first)))
    top_m = score_top_m(overview)
    return rrb.TimeSeriesView(
        origin=paths.CURVE,
        name=f"{overview.objective} (m)",
        plot_legend=rrb.Corner2D.RightTop,
        axis_x=rrb.TimeAxis(
            view_range=rrb.TimeRange(
                start=rrb.TimeRangeBoundary.absolute(seq=first - 1),
                end=rrb.TimeRangeBoundary.absolute(seq=last),
            )
        ),
        # The points appear with their trials.
        time_ranges=rrb.VisibleTimeRanges(
            timeline=paths.TIMELINE,
            start=rrb.TimeRangeBoundary.infinite(),
            end=rrb.TimeRangeBoundary.cursor_relative(),
        ),
        axis_y=rrb.ScalarAxis(range=(-0.05 * top_m, 1.05 * top_m)),
    )
