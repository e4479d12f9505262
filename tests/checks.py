"""What every Transform must stand, whatever it computes."""

from collections.abc import Callable, Sequence
from functools import partial

import torch
from torchrl.envs import EnvBase, ParallelEnv, SerialEnv, Transform, TransformedEnv
from torchrl.envs.utils import check_env_specs

MakeEnv = Callable[[Sequence[int]], EnvBase]
MakeTransform = Callable[[], Transform]


def transformed(
    make_env: MakeEnv, make_transform: MakeTransform, batch_size: Sequence[int] = ()
) -> EnvBase:
    """Return the env of ``batch_size`` under the transform; picklable by spawn."""
    return TransformedEnv(make_env(batch_size), make_transform())


def check_transform(make_env: MakeEnv, make_transform: MakeTransform) -> None:
    """Check the specs in every place a transform can have, and a partial reset.

    ``make_env(batch_size)`` must return an env whose episodes end within ten
    decisions, so that the check passes through a reset.
    """
    inside = partial(transformed, make_env, make_transform)
    several = partial(inside, (3,))
    envs = {
        "alone": inside(),
        "batched": several(),
        "Serial(Transformed)": SerialEnv(2, inside),
        "Serial(Transformed batched)": SerialEnv(2, several),
        "Transformed(Serial)": TransformedEnv(
            SerialEnv(2, partial(make_env, ())), make_transform()
        ),
    }
    for place, env in envs.items():
        try:
            check_env_specs(env, break_when_any_done="both")
        except Exception as error:
            raise AssertionError(f"the specs do not hold in {place}") from error
        finally:
            env.close()
    check_partial_reset(several())
    check_partial_reset(SerialEnv(3, inside))
    check_partial_reset(
        TransformedEnv(SerialEnv(3, partial(make_env, ())), make_transform())
    )


def check_parallel(make_env: MakeEnv, make_transform: MakeTransform) -> None:
    """Check the specs in two spawned workers; both arguments must be picklable."""
    inside = partial(transformed, make_env, make_transform)
    env = ParallelEnv(2, inside, mp_start_method="spawn")
    try:
        check_env_specs(env, break_when_any_done="both")
    finally:
        env.close()


def check_partial_reset(env: EnvBase) -> None:
    """Reset the middle one of three envs: the others keep every entry."""
    before = env.rollout(2)[:, -1]["next"].clone()
    mask = torch.tensor([[False], [True], [False]])
    after = env.reset(before.clone().set("_reset", mask))
    for row in (0, 2):
        kept = after[row].exclude("reward")
        assert (kept == before[row].select(*kept.keys(True, True))).all(), row
    env.close()
