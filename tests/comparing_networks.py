"""Comparisons that tests can foretell."""

import torch


class Lookup:
    """Similarities from a table; the embedding of observation i is the number i."""

    def __init__(self, table):
        self.table = torch.as_tensor(table, dtype=torch.float32)

    @property
    def sequence(self):
        return torch.arange(float(len(self.table))).unsqueeze(1)

    def prepare_memory(self, memory):
        return memory

    def compare_prepared(self, embedding, prepared):
        rows = embedding.unsqueeze(-2)[..., 0].long()
        return self.table[rows, prepared[..., 0].long()]


class Nearness:
    """``1 / (1 + distance)`` of embeddings."""

    def prepare_memory(self, memory):
        return memory

    def compare_prepared(self, embedding, prepared):
        return 1 / (1 + (embedding.unsqueeze(-2) - prepared).norm(dim=-1))


class Places(Lookup):
    """Similarities of places by a table; a view ``[1]`` is the number of its place."""

    encoder = embed = staticmethod(lambda views: views.float())
