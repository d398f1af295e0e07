"""Which stages an adaptation has, in which order."""

import numpy as np
import pytest

from jaxcap.adapt.adapt_round import shape_weights
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
    first, last = settings.shape_weights
    weights = [shape_weights(settings, Stage("adapt", 1, step)) for step in (1, 5)]
    assert np.array(weights) == pytest.approx(np.array([[first], [last]]))
    # the last one is chosen from several
    choice = shape_weights(settings, Stage("adapt", 2, 3))
    assert choice[0] == pytest.approx(last)
    assert choice[-1] == pytest.approx(first)
    assert list(choice) == sorted(choice)
    assert [stage.name for stage in plan_stages(AdaptSettings(proportion_rounds=0, rounds=()))] == [
        "size",
        "track",
        "pose",
        "smooth",
    ]
    while_tracking = [str(stage) for stage in plan_stages(AdaptSettings(every=10))]
    assert while_tracking[:4] == ["size", "track to frame 10", "adapt to frame 10", "track to frame 20"]
    assert while_tracking.index("adapt to frame 100") < while_tracking.index("track")
