import time
from collections import defaultdict

import pytest
from torchrl.collectors import _multi_base
from torchrl.weight_update import NoWeightSyncScheme

from tests.collectors.workers import EchoPolicy, make_counting_env
from toponav.collectors import PatientAsyncCollector
from toponav.keys import TRAJECTORY


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_there_is_room_for_one_batch_of_every_process(
    workers: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Context:
        """Of multiprocessing: says how long a queue is wanted, and starts nothing."""

        def get_start_method(self) -> str:
            return "spawn"

        def Queue(self, length: int) -> None:  # noqa: N802
            raise InterruptedError(length)

    monkeypatch.setattr(_multi_base, "_get_mp_ctx", Context)
    with pytest.raises(InterruptedError) as found:
        PatientAsyncCollector(
            [make_counting_env] * workers,
            policy_factory=EchoPolicy,
            frames_per_batch=24,
            total_frames=-1,
            weight_sync_schemes={"policy": NoWeightSyncScheme()},
            auto_register_policy_transforms=False,
        )
    assert found.value.args == (workers,)


@pytest.mark.slow
def test_a_caller_who_is_busy_loses_no_decision() -> None:
    collector = PatientAsyncCollector(
        [make_counting_env] * 2,
        policy_factory=EchoPolicy,
        frames_per_batch=24,
        total_frames=-1,
        weight_sync_schemes={"policy": NoWeightSyncScheme()},
        auto_register_policy_transforms=False,
    )
    steps: dict[int, list[int]] = defaultdict(list)
    try:
        for number, batch in enumerate(collector):
            entries = zip(
                batch[TRAJECTORY].flatten().tolist(),
                batch["step_count"].flatten().tolist(),
                strict=True,
            )
            for trajectory, step in entries:
                steps[trajectory].append(step)
            # Longer than TorchRL waits for room in its queue.
            time.sleep(1.5 if number < 3 else 0)
            if number == 8:
                break
    finally:
        collector.shutdown()
    # Two processes with three mazes each, whose episodes do not end.
    assert len(steps) == 6
    assert sum(map(len, steps.values())) == 9 * 24
    for one in steps.values():
        assert one == list(range(len(one)))
