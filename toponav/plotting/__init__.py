"""Figures, plans and videos in one style."""

from toponav.plotting.contact_sheet import (
    contact_sheet as contact_sheet,
    spread_out as spread_out,
)
from toponav.plotting.curves import (
    draw_curves as draw_curves,
    draw_success as draw_success,
    draw_training as draw_training,
)
from toponav.plotting.goals import draw_goals as draw_goals
from toponav.plotting.network_report import draw_report as draw_report
from toponav.plotting.plan import FloorPlan as FloorPlan, draw_plan as draw_plan
from toponav.plotting.style import save_figure as save_figure
from toponav.plotting.sweeps import (
    draw_learning_curves as draw_learning_curves,
    draw_sweep as draw_sweep,
)
from toponav.plotting.topology import (
    draw_graph as draw_graph,
    draw_topological_map as draw_topological_map,
)
from toponav.plotting.video import (
    explored_frames as explored_frames,
    navigated_frames as navigated_frames,
    render_plan as render_plan,
    side_by_side as side_by_side,
    write_video as write_video,
)
from toponav.plotting.walks import (
    draw_exploration as draw_exploration,
    draw_leg as draw_leg,
)
