"""A small explored episode, for the tests of its numbers and pictures."""

import torch
from tensordict import TensorDict

from toponav.metrics import EpisodeTrace, trace_episode

#: A corridor of four cells that the agent can walk, and one that it does not reach.
MASK = torch.tensor([[True, True, True, True, True]])
X = [64.0, 192.0, 320.0, 192.0, 448.0]
CELLS = [0, 1, 2, 1, 3]
REWARD = [0.0, 1.0, 2.0, 0.5, 3.0]
IS_NEW_WAYPOINT = [True, False, True, False, True]
FALSE = [False, False, True, False, False]
COVERAGE = [0.2, 0.4, 0.6, 0.6, 0.8]


def episode() -> TensorDict:
    """Four decisions as a rollout has them: five observations, root and next."""

    def column(values: list[float] | list[bool]) -> torch.Tensor:
        return torch.tensor(values).unsqueeze(-1)

    place = {
        "position": torch.tensor([[x, 64.0] for x in X]),
        "heading": column([0.0, 0.0, 0.0, 180.0, 0.0]),
        "cell": torch.tensor([[0, cell] for cell in CELLS]),
        "coverage": column(COVERAGE),
        "spurious_waypoint": column(FALSE),
    }
    reward = column(REWARD)
    observed = TensorDict(
        {"privileged": place, "is_new_waypoint": column(IS_NEW_WAYPOINT)}, [5]
    )
    paid = {"intrinsic_reward": reward[1:]}
    root = TensorDict(observed[:4].to_dict(), [4])
    root["next"] = TensorDict({**observed[1:].to_dict(), **paid}, [4])
    return root


def trace() -> EpisodeTrace:
    return trace_episode(episode())
