"""From random walks to curiosity, a map and walks to pictures, in rooms of MiniGrid.

pip install minigrid; python examples/curious_minigrid.py --seed 0
"""

import argparse
from functools import partial

import torch
from painted_rooms import count_squares, make_env, share_arrived
from tensordict.nn import TensorDictModule, TensorDictSequential
from torchrl.collectors import Collector
from torchrl.envs import InitTracker

from toponav import data, graph, keys, modules, objectives, transforms

parser = argparse.ArgumentParser()
for name, number in (("seed", 0), ("walks", 20), ("updates", 1000), ("batches", 30)):
    parser.add_argument(f"--{name}", type=int, default=number)
given = parser.parse_args()
torch.manual_seed(given.seed)
make_env = partial(make_env, envs=16, length=256, seed=given.seed)
collect = partial(Collector, frames_per_batch=4096)  # 16 whole episodes, [16, 256]

# Random walks teach which views are close in time, and which action leads to another.
rooms = make_env()
actions = rooms.world.num_actions
walks = torch.cat([*collect(rooms, None, total_frames=4096 * (given.walks + 1))])
walks, held_out, usual = walks[:-16], walks[-16:], count_squares(walks)
encoder = modules.SmallEncoder(64, image_size=(28, 28))
network = modules.TCNetwork(encoder, modules.ConcatComparator(64, hidden=[128, 128]))
head = modules.LocomotionHead(64, num_actions=actions, hidden=[128, 128])
pairs = data.MinedPairs(walks, embed_tc=network.embed, in_key=keys.PIXELS)
tc_loss, l_loss = objectives.TCLoss(network.comparator), objectives.LLoss(head)
optimizer = torch.optim.AdamW([*network.parameters(), *head.parameters()], 1e-3)
for _ in range(given.updates):
    tc_pairs, l_pairs = pairs()
    optimizer.zero_grad()
    (tc_loss(tc_pairs)["loss_tc"] + l_loss(l_pairs)["loss_locomotion"]).backward()
    optimizer.step()
network.eval()
unseen, _ = data.DrawnPairs(held_out, 4096, in_key=keys.PIXELS)()  # half of them close
right = (network(unseen[keys.ANCHOR], unseen[keys.OTHER]) > 0) == unseen[keys.LABEL]
print(f"TC-network: {right.float().mean():.1%} of held-out pairs right")
embeddings = map(network.embed, held_out[keys.PIXELS])
seen = [graph.WalkWaypoints(one, network) for one in embeddings]

# PPO explores for novelty; by the threshold a twentieth of random walks' views is new.
threshold = graph.calibrate_share(seen, target_share=0.05).threshold
policy = modules.ActorCritic(num_actions=actions, embedding_dim=64, hidden_dim=128)
novelty = transforms.make_novelty_reward(network, threshold)
env = make_env(*novelty, *transforms.make_policy_inputs(policy))
loss = objectives.RecurrentPPOLoss(policy).make_value_estimator(gamma=0.99, lmbda=0.95)
loss.set_keys(reward=keys.SCALED_REWARD)
scale = objectives.ReturnScale(16)
cut = objectives.SequenceMinibatches(32, num_minibatches=4)
optimizer = torch.optim.Adam(policy.parameters(), 3e-4)
for batch in collect(env, policy, total_frames=4096 * given.batches):
    loss.estimate_advantage(scale(batch))
    for part in (part for _ in range(4) for part in cut(batch)):
        found = loss(part)
        optimizer.zero_grad()
        sum(found[f"loss_{n}"] for n in ("objective", "critic", "entropy")).backward()
        torch.nn.utils.clip_grad_norm_(policy.parameters(), 0.5)
        optimizer.step()
    print(f"explorer: {count_squares(batch):.1f} squares, random: {usual:.1f}")

# What its last episodes saw becomes a map, over which an agent walks to pictures.
known = graph.TopologicalMap(network.embed, network.compare, graph.calibrate_map(seen))
for episode in batch:
    known.add_episode(episode)
print(f"map: {known.num_waypoints:,} waypoints, {len(known.edges):,} edges")
goals = walks.reshape(-1)[torch.randint(walks.numel(), (64,))]
show = TensorDictModule(lambda: goals[keys.PIXELS].unsqueeze(1), [], [keys.GOAL_VIEWS])
navigator = TensorDictSequential(show, graph.Navigator.over(known, head))
rooms = partial(make_env, envs=64, seed=given.seed + 1)
ours, theirs = (rooms(InitTracker()).rollout(256, one) for one in (navigator, None))
for by in (64, 128, 192, 256):
    map_share, random = (share_arrived(walk, goals, by) for walk in (ours, theirs))
    print(f"after {by} decisions: by the map {map_share:.0%}, at random {random:.0%}")
