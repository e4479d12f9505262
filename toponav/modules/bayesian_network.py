"""`BayesianNetwork`: its weights are Gaussians; says how much an outcome teaches it."""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

#: Deviation of all weights before anything is learned, as in the authors' code.
_PRIOR_DEVIATION = 0.5


def gaussian_divergence(
    mean: Tensor, deviation: Tensor, other_mean: Tensor, other_deviation: Tensor
) -> Tensor:
    """KL(first || other) in nats of Gaussians, elementwise.

    Examples:
        >>> one = torch.ones(1)
        >>> gaussian_divergence(one, one, 0 * one, one)  # half the squared distance
        tensor([0.5000])
    """
    ratio = deviation / other_deviation
    shift = (mean - other_mean) / other_deviation
    return 0.5 * (ratio.square() + shift.square() - 1) - ratio.log()


class GaussianLinear(nn.Module):
    """A linear layer with weights N(mean, softplus(rho)^2); the last one is the bias.

    Args:
        num_inputs: number I of inputs, without the constant of the bias.
        num_outputs: number O of outputs.
    """

    def __init__(self, num_inputs: int, num_outputs: int) -> None:
        super().__init__()
        shape = (num_outputs, num_inputs + 1)
        self.mean = nn.Parameter(torch.randn(shape) / math.sqrt(num_inputs + 1))
        # The inverse of softplus.
        start = math.log(math.expm1(_PRIOR_DEVIATION))
        self.rho = nn.Parameter(torch.full(shape, start))

    @property
    def deviation(self) -> Tensor:
        """Standard deviations of the weights, ``[O, I + 1]``."""
        return F.softplus(self.rho)

    def forward(self, inputs: Tensor, noise: Tensor) -> Tensor:
        """Outputs by S draws of the weights, ``[S, N, I + 1]`` to ``[S, N, O]``.

        What is drawn is the noise of an output, ``[S, 1, O]``: by local
        reparametrisation (Kingma et al., 2015) nobody draws the weights themselves.
        Inputs ``[1, N, I + 1]`` are the same in all draws.
        """
        centre = F.linear(inputs, self.mean)
        return centre + self.spread(inputs) * noise

    def spread(self, inputs: Tensor) -> Tensor:
        """Deviation of the outputs."""
        return F.linear(inputs.square(), self.deviation.square()).sqrt()

    def divergence(self) -> Tensor:
        """KL from the prior in nats."""
        zero, prior = self.mean.new_tensor([0.0, _PRIOR_DEVIATION])
        return gaussian_divergence(self.mean, self.deviation, zero, prior).sum()


class BayesianNetwork(nn.Module):
    """A network with one hidden layer of ReLU and Gaussian weights.

    It learns by `loss`, the negative evidence lower bound. `information_gain` says how
    far its weights would move, in nats, if it learned from one more outcome.

    Reference:
        Blundell et al., "Weight Uncertainty in Neural Networks" (2015); Houthooft et
        al., "VIME: Variational Information Maximizing Exploration" (2016), section 2.4
        and eqs. 14 to 17, with the sizes of their code as defaults.

    Args:
        num_inputs: number I of inputs.
        num_outputs: number O of outputs.
        hidden: width of the hidden layer.
        noise_deviation: of an outcome around its prediction, in its own units.
        draws: number S of draws of the weights that losses are averaged over.

    Examples:
        >>> network = BayesianNetwork(3, 2)
        >>> inputs, outcomes = torch.randn(5, 3), torch.randn(5, 2)
        >>> network(inputs).shape
        torch.Size([10, 5, 2])
        >>> network.information_gain(inputs, outcomes, step=0.01).shape
        torch.Size([5])

    Shape notation:
        N: outcomes.
    """

    def __init__(
        self,
        num_inputs: int,
        num_outputs: int,
        *,
        hidden: int = 32,
        noise_deviation: float = 5.0,
        draws: int = 10,
    ) -> None:
        super().__init__()
        self.noise_deviation = noise_deviation
        self.draws = draws
        self.layers = nn.ModuleList(
            [
                GaussianLinear(num_inputs, hidden),
                GaussianLinear(hidden, num_outputs),
            ]
        )

    def forward(self, inputs: Tensor) -> Tensor:
        """Predictions by each draw of the weights, ``[N, I]`` to ``[S, N, O]``."""
        return self._trace(inputs)[-1][2]

    def loss(
        self, predictions: Tensor, outcomes: Tensor, prior_weight: float
    ) -> Tensor:
        """Negative log likelihood of the outcomes, plus the weighed KL from the prior.

        Up to a constant; summed over the outcomes. ``predictions`` are what the network
        returns, ``[S, N, O]``.
        """
        error = self._errors(predictions, outcomes).sum()
        return error + prior_weight * self.divergence()

    def divergence(self) -> Tensor:
        """KL from the prior in nats."""
        return torch.stack([layer.divergence() for layer in self._gaussians()]).sum()

    def information_gain(self, inputs: Tensor, outcomes: Tensor, step: float) -> Tensor:
        """KL in nats by which each outcome alone would move the weights.

        To second order, of one step ``step * H^-1 g`` with the gradient ``g`` of its
        negative log likelihood and the Hessian ``H`` of the KL, which is diagonal:
        ``step^2 / 2 * g' H^-1 g``. The weights stay as they are.

        Args:
            inputs: ``[N, I]``.
            outcomes: ``[N, O]``.
            step: length of the step.

        Returns:
            ``[N]``, without gradients.
        """
        with torch.enable_grad():
            traces = self._trace(inputs.detach())
            error = self._errors(traces[-1][2], outcomes.detach()).sum()
            slopes = torch.autograd.grad(error, [trace[2] for trace in traces])
        total = torch.zeros(len(inputs), device=inputs.device)
        with torch.no_grad():
            parts = zip(self._gaussians(), traces, slopes, strict=True)
            for layer, (values, noise, _), slope in parts:
                total += self._layer_gain(layer, values, noise, slope)
        return 0.5 * step**2 * total

    def _gaussians(self) -> list[GaussianLinear]:
        return [one for one in self.layers if isinstance(one, GaussianLinear)]

    def _trace(self, inputs: Tensor) -> list[tuple[Tensor, Tensor, Tensor]]:
        """Of each layer: inputs with their constant, noise, outputs before the ReLU."""
        traces: list[tuple[Tensor, Tensor, Tensor]] = []
        values = inputs.unsqueeze(0)  # the same in all draws
        for layer in self._gaussians():
            if traces:
                values = F.relu(traces[-1][2])
            values = F.pad(values, (0, 1), value=1.0)
            shape = (self.draws, 1, len(layer.mean))
            noise = torch.randn(shape, device=inputs.device)
            traces.append((values, noise, layer(values, noise)))
        return traces

    def _errors(self, predictions: Tensor, outcomes: Tensor) -> Tensor:
        """Negative log likelihood up to a constant, ``[S, N, O]`` to ``[N]``."""
        scaled = (predictions - outcomes) / self.noise_deviation
        return 0.5 * scaled.square().sum(-1).mean(0)

    @staticmethod
    def _layer_gain(
        layer: GaussianLinear, values: Tensor, noise: Tensor, slope: Tensor
    ) -> Tensor:
        """The layer's g' H^-1 g, ``[N]``, from the loss's slope in its outputs.

        H is 1 / s^2 for a mean and 2 (ds / drho)^2 / s^2 for a rho, with deviations s.
        """
        variance = layer.deviation.square()
        by_noise = slope * noise / layer.spread(values)
        # The slope of rho lacks a factor s * ds / drho: its square over H is s^4 / 2.
        of_mean = _weighed_squares(slope, values, variance)
        of_rho = _weighed_squares(by_noise, values.square(), variance.square())
        return of_mean + 0.5 * of_rho


def _weighed_squares(slope: Tensor, values: Tensor, weights: Tensor) -> Tensor:
    """Sum over o, i of weights_oi (sum over s of slope_sno values_sni)^2, ``[N]``."""
    if len(values) == 1:
        sums = F.linear(values[0].square(), weights)
        return (slope.sum(0).square() * sums).sum(-1)
    products = torch.bmm(slope.permute(1, 2, 0), values.transpose(0, 1))
    return products.square_().flatten(1) @ weights.flatten()
