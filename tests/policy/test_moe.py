import pytest
import torch

from openclone.policy.moe import MoeConfig, MoeLayer, MoeNetwork, balance_loss


def test_layer_is_the_weighted_sum_of_the_two_best_experts():
    torch.manual_seed(0)
    layer = MoeLayer(8, 4, 2).eval()  # which trains with shorter numbers
    hidden = torch.randn(5, 8)
    output, weights = layer(hidden)
    for row in range(5):
        routing = torch.softmax(layer.router(hidden[row]), 0)
        torch.testing.assert_close(weights[row], routing)
        expected = torch.zeros(8)
        for expert in torch.argsort(routing, descending=True)[:2].tolist():
            part = slice(8 * expert, 8 * expert + 8)
            matrix, bias = layer.expert.weight[part], layer.expert.bias[part]
            value = torch.nn.functional.elu(matrix @ hidden[row] + bias)
            expected += routing[expert] * value
        torch.testing.assert_close(output[row], expected)


def test_shape_of_the_paper():
    network = MoeNetwork(20, 29, MoeConfig())
    output, routing = network.with_routing(torch.zeros(3, 20))
    assert output.shape == (3, 29)
    assert [weights.shape for weights in routing] == [(3, 4)] * 3


def test_balance_loss_by_hand():
    uniform = torch.full((10, 4), 0.25)
    assert float(balance_loss([uniform])) == 0.0
    # Within the slack of 25 % of 1/4: still free.
    assert float(balance_loss([torch.tensor([[0.3, 0.2, 0.25, 0.25]])])) == 0.0
    collapsed = torch.tensor([[1.0, 0, 0, 0]])
    # (1 - 0.3125) + 3 x 0.1875, per layer.
    assert float(balance_loss([collapsed] * 2)) == pytest.approx(2.5)


def test_balance_is_about_the_mean_not_the_single_choice():
    decided = torch.eye(4)
    assert float(balance_loss([decided])) == 0.0


def test_balance_loss_pulls_towards_idle_experts():
    logits = torch.tensor([[3.0, 0, 0, -3.0]], requires_grad=True)
    balance_loss([torch.softmax(logits, -1)]).backward()
    assert logits.grad is not None
    assert logits.grad[0, 0] > 0 > logits.grad[0, 3]
