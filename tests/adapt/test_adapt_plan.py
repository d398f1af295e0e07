"""Which stages an adaptation has, in which order."""

import pytest

from jaxcap.adapt.adapt_round import shape_weight
from jaxcap.adapt.task import AdaptSettings, Stage, plan_stages


def test_the_plan_has_all_stages_and_weights_fall():
    settings = AdaptSettings(proportion_rounds=2, rounds=(5, 3), temporal_weight=0.0)
    names = [stage.name for stage in plan_stages(settings)]
    assert names == [
        "size",
        "track",
        *2 * ["adapt"],
        "turn",
        *5 * ["adapt"],
        "track",
        *3 * ["adapt"],
        "track",
        "pose",
    ]
    weights = [shape_weight(settings, Stage("adapt", 1, step)) for step in (1, 5)]
    assert weights == pytest.approx(list(settings.shape_weights))
    assert [stage.name for stage in plan_stages(AdaptSettings(proportion_rounds=0, rounds=()))] == [
        "size",
        "track",
        "pose",
        "smooth",
    ]
    while_tracking = [str(stage) for stage in plan_stages(AdaptSettings(every=10))]
    assert while_tracking[:4] == ["size", "track to frame 10", "adapt to frame 10", "track to frame 20"]
    assert while_tracking.index("adapt to frame 100") < while_tracking.index("track")
