"""What was made quicker gives the numbers of what it replaces."""

import copy

import pytest
import torch
from rsl_rl.algorithms import PPO
from rsl_rl.modules import EmpiricalNormalization
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict
from torch import nn

from openclone.policy import linear
from openclone.policy.linear import Linear, quicken
from openclone.policy.normalization import Normalization
from openclone.training.ppo import PpoConfig, build_ppo, fuse, mlp_model
from openclone.training.storage import Rollouts

ROBOTS, STEPS, SIZE = 32, 6, 40
CONFIG = PpoConfig(steps=STEPS, epochs=3, minibatches=4, hidden=(48, 24))


@pytest.fixture
def exact(monkeypatch):
    """Gradients in 32 bits, whatever the processor."""
    monkeypatch.setattr(linear, "SHORT", torch.float32)


def layers() -> tuple[nn.Linear, Linear]:
    torch.manual_seed(0)
    plain, quick = nn.Linear(17, 9), Linear(17, 9)
    quick.load_state_dict(plain.state_dict())
    return plain, quick


@pytest.mark.parametrize("rows", [1, 2, 33])
def test_linear_is_linear_with_its_gradients(rows, exact):
    results = []
    for layer in layers():
        torch.manual_seed(1)
        inputs = torch.randn(rows, 17, requires_grad=True)
        outputs = layer(inputs)
        outputs.square().sum().backward()
        results.append((outputs, inputs.grad, layer.weight.grad, layer.bias.grad))
    for expected, found in zip(*results, strict=True):
        torch.testing.assert_close(found, expected, atol=1e-5, rtol=1e-5)


@pytest.mark.skipif(
    not torch.ops.mkldnn._is_mkldnn_bf16_supported(),
    reason="oneDNN has no products of 16-bit floats on this processor",
)
def test_gradients_of_short_numbers_are_nearly_the_same(monkeypatch):
    results = []
    for kind in (torch.float32, torch.bfloat16):
        monkeypatch.setattr(linear, "SHORT", kind)
        layer = layers()[1]
        torch.manual_seed(1)
        inputs = torch.randn(400, 17, requires_grad=True)
        layer(inputs).square().sum().backward()
        results.append((inputs.grad, layer.weight.grad, layer.bias.grad))
    for exactly, roughly in zip(*results, strict=True):
        assert roughly.dtype == torch.float32
        assert (roughly - exactly).norm() <= 5e-3 * exactly.norm()
    assert not torch.equal(results[0][1], results[1][1])


def test_linear_is_differentiable_twice(exact):
    """As the gradient penalty of AMP needs it."""
    results = []
    for layer in layers():
        torch.manual_seed(1)
        inputs = torch.randn(5, 17, requires_grad=True)
        total = layer(inputs).tanh().sum()
        (slope,) = torch.autograd.grad(total, inputs, create_graph=True)
        slope.square().sum().backward()
        results.append((layer.weight.grad, layer.bias.grad, inputs.grad))
    for expected, found in zip(*results, strict=True):
        torch.testing.assert_close(found, expected, atol=1e-5, rtol=1e-5)


def test_linear_takes_what_onednn_does_not():
    plain, quick = layers()
    for inputs in (torch.randn(2, 3, 17), torch.randn(17)):
        torch.testing.assert_close(quick(inputs), plain(inputs))
    doubles = torch.randn(4, 17, dtype=torch.float64)
    torch.testing.assert_close(quick.double()(doubles), plain.double()(doubles))
    assert Linear(3, 2, device="meta")(torch.empty(5, 3, device="meta")).shape == (5, 2)


def test_quickened_layers_keep_their_parameters(exact):
    net = nn.Sequential(nn.Linear(4, 3), nn.ELU(), nn.Linear(3, 2))
    inputs, before = torch.randn(6, 4), list(net.parameters())
    expected = net(inputs)
    quicken(net)
    assert [type(net[k]) for k in (0, 2)] == [Linear, Linear]
    after = list(net.parameters())
    assert all(a is b for a, b in zip(after, before, strict=True))
    torch.testing.assert_close(net(inputs), expected)


def test_normalization_counts_like_rsl_rl():
    ours, theirs = Normalization(5), EmpiricalNormalization(5)
    torch.manual_seed(0)
    for rows in (3, 1, 200, 64):
        batch = 4.0 * torch.randn(rows, 5) + torch.tensor([0.0, 1.0, -50.0, 3.0, 0.2])
        ours.update(batch)
        theirs.update(batch)
    for name, expected in theirs.state_dict().items():
        torch.testing.assert_close(ours.state_dict()[name], expected)
    ours.eval()
    ours.update(torch.ones(3, 5))
    assert ours.count == 268


def filled(storage: RolloutStorage) -> RolloutStorage:
    torch.manual_seed(2)
    for name in ("actions", "values", "returns", "advantages", "actions_log_prob"):
        getattr(storage, name).normal_()
    storage.observations["teacher"].normal_()
    mean = torch.randn(STEPS, ROBOTS, 29)
    storage.distribution_params = (mean, torch.rand(STEPS, ROBOTS, 29) + 0.2)
    return storage


def example() -> TensorDict:
    return TensorDict({"teacher": torch.zeros(ROBOTS, SIZE)}, batch_size=[ROBOTS])


def test_minibatches_are_those_of_rsl_rl():
    theirs = RolloutStorage("rl", ROBOTS, STEPS, example(), [29], "cpu")
    runs = []
    for storage in (filled(theirs), filled(Rollouts(example(), STEPS))):
        torch.manual_seed(3)
        runs.append(list(storage.mini_batch_generator(4, 2)))
    assert len(runs[0]) == len(runs[1]) == 8
    for expected, found in zip(*runs, strict=True):
        for name in ("actions", "values", "advantages", "returns"):
            assert torch.equal(getattr(expected, name), getattr(found, name))
        assert torch.equal(
            expected.observations["teacher"], found.observations["teacher"]
        )
        assert torch.equal(expected.old_actions_log_prob, found.old_actions_log_prob)
        old, new = expected.old_distribution_params, found.old_distribution_params
        assert all(torch.equal(a, b) for a, b in zip(old, new, strict=True))


def slow(ppo: PPO) -> PPO:
    """The same networks in rsl_rl's own PPO, storage and normalization."""
    for model in (ppo.actor, ppo.critic):
        for layer in model.mlp:
            if isinstance(layer, Linear):
                layer.__class__ = nn.Linear  # type: ignore[assignment]
            elif isinstance(layer, nn.ELU):
                layer.inplace = False
        theirs = EmpiricalNormalization(SIZE)
        theirs.load_state_dict(model.obs_normalizer.state_dict())
        model.obs_normalizer = theirs
    storage = RolloutStorage("rl", ROBOTS, STEPS, example(), [29], "cpu")
    plain = PPO(
        ppo.actor, ppo.critic, storage, num_learning_epochs=3, num_mini_batches=4,
        entropy_coef=CONFIG.entropy, learning_rate=CONFIG.learning_rate,
        desired_kl=CONFIG.kl, use_clipped_value_loss=False,
    )  # fmt: skip
    plain.optimizer = ppo.optimizer
    for group in plain.optimizer.param_groups:
        group["fused"] = None
    return plain


def iteration(ppo: PPO) -> dict[str, float]:
    torch.manual_seed(4)
    ppo.train_mode()
    observations = example()
    with torch.inference_mode():
        for _ in range(STEPS):
            action = ppo.act(observations)
            seen = torch.cat((action, observations["teacher"][:, :11].cos()), -1)
            observations = TensorDict({"teacher": seen}, batch_size=[ROBOTS])
            done = seen[:, 0] > 1.0
            ppo.process_env_step(
                observations, seen[:, 1].sin(), done, {"time_outs": done}
            )
        ppo.compute_returns(observations)
    return ppo.update()


def test_an_iteration_of_ppo_learns_what_rsl_rl_learns(exact):
    torch.manual_seed(0)
    actor = mlp_model(example(), "teacher", 29, CONFIG)
    critic = mlp_model(example(), "teacher", 1, CONFIG)
    twins = copy.deepcopy((actor, critic))
    quick = build_ppo(example(), actor, critic, CONFIG)
    plain = slow(build_ppo(example(), twins[0], twins[1], CONFIG))
    start = copy.deepcopy(quick.actor.state_dict())
    for _ in range(2):
        losses, expected = iteration(quick), iteration(plain)
        assert losses == pytest.approx(expected, rel=1e-4, abs=1e-6)
        assert quick.learning_rate == plain.learning_rate
    for ours, theirs in ((quick.actor, plain.actor), (quick.critic, plain.critic)):
        for name, value in theirs.state_dict().items():
            torch.testing.assert_close(
                ours.state_dict()[name], value, atol=1e-4, rtol=1e-4
            )
    assert any(
        not torch.equal(v, start[k]) for k, v in quick.actor.state_dict().items()
    )


def test_a_loaded_optimizer_is_fused_again():
    net = nn.Linear(2, 2)
    adam = torch.optim.Adam(net.parameters())
    assert adam.param_groups[0]["fused"] is None
    other = torch.optim.Adam(net.parameters())
    fuse(other)
    other.load_state_dict(adam.state_dict())
    assert other.param_groups[0]["fused"] is None
    fuse(other)
    net(torch.ones(1, 2)).sum().backward()
    other.step()
    assert other.param_groups[0]["fused"] is True
