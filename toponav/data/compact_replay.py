"""`CompactReplay`: a replay buffer whose state has no memory for what is to come."""

from collections.abc import Mapping
from typing import Any

from tensordict import TensorDict
from torchrl.data import TensorDictReplayBuffer


class CompactReplay(TensorDictReplayBuffer):
    """TorchRL's buffer, with a state of the frames that it keeps and no others.

    TorchRL's has all of the storage, as large as it may become. A generator that was
    set for the draws is not in it.

    Examples:
        >>> import torch
        >>> from torchrl.data import LazyTensorStorage
        >>> replay = CompactReplay(storage=LazyTensorStorage(1000))
        >>> _ = replay.extend(TensorDict({"view": torch.zeros(3, 8)}, [3]))
        >>> replay.state_dict()["frames"]["view"].shape
        torch.Size([3, 8])
    """

    def state_dict(self) -> dict[str, Any]:
        """What is kept, in its order, and where the next frame comes."""
        # A copy: a part of the storage would be saved with all of it.
        frames = self.storage[:].clone().to_dict() if len(self) else {}
        return {"frames": frames, "writer": self.writer.state_dict()}

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        """Keep what another one did; TorchRL's own state will do, too."""
        if "_storage" in state_dict:  # of earlier runs
            super().load_state_dict(dict(state_dict))
            return
        frames = TensorDict(state_dict["frames"]).auto_batch_size_(1)
        self.empty()
        if not frames.is_empty():
            self.extend(frames)
        self.writer.load_state_dict(state_dict["writer"])
