"""From random walks to curiosity, a map and walks to pictures, in rooms of MiniGrid.

pip install minigrid; python examples/curious_minigrid.py --seed 0
"""

import argparse
from collections import deque
from functools import partial

import torch
from painted_rooms import count_squares, make_env, share_arrived, share_right, walk_to
from torchrl.collectors import Collector

from toponav import data, graph, keys, modules, objectives, policies, transforms

parser = argparse.ArgumentParser()
for name, number in (("seed", 0), ("walks", 12), ("updates", 600), ("batches", 20)):
    parser.add_argument(f"--{name}", type=int, default=number)
given, num = parser.parse_args(), 3  # actions: left, right, ahead
torch.manual_seed(given.seed)
make_env = partial(make_env, envs=16, length=256, seed=given.seed)
collect = partial(Collector, frames_per_batch=4096)  # 16 whole episodes, [16, 256]

# Random walks, mostly ahead, teach which views are close in time and what leads there.
stroll = policies.StickyPolicy(num, stickiness=0, weights=(1, 1, 3), seed=given.seed)
walks = torch.cat([*collect(make_env(), stroll, total_frames=4096 * (given.walks + 1))])
walks, held_out, usual = walks[:-16], walks[-16:], count_squares(walks)
encoder = modules.SmallEncoder(64, image_size=(28, 28))
network = modules.TCNetwork(encoder, modules.ConcatComparator(64, hidden=[128, 128]))
head = modules.LocomotionHead(64, num_actions=num, hidden=[128, 128])
how = {"tc_pairs": data.TCPairs(other_episode_share=0.5), "in_key": keys.PIXELS}
pairs = data.MinedPairs(walks, embed_tc=network.embed, **how)
tc_loss, l_loss = objectives.TCLoss(network.comparator), objectives.LLoss(head)
optimizer = torch.optim.AdamW([*network.parameters(), *head.parameters()], 1e-3)
for _ in range(given.updates):
    tc_pairs, l_pairs = pairs()
    optimizer.zero_grad()
    (tc_loss(tc_pairs)["loss_tc"] + l_loss(l_pairs)["loss_locomotion"]).backward()
    optimizer.step()
print(f"TC-network: {share_right(network.eval(), held_out):.1%} of new pairs right")
seen = [graph.WalkWaypoints(network.embed(e), network) for e in held_out[keys.PIXELS]]

# PPO explores for novelty; by the threshold a twentieth of random walks' views is new.
threshold = graph.calibrate_share(seen, target_share=0.05).threshold
policy = modules.ActorCritic(num_actions=num, embedding_dim=64, hidden_dim=128)
novelty = transforms.make_novelty_reward(network, threshold)
env = make_env(*novelty, *transforms.make_policy_inputs(policy))
loss = objectives.RecurrentPPOLoss(policy).make_value_estimator(gamma=0.99, lmbda=0.95)
loss.set_keys(reward=keys.SCALED_REWARD)
scale, recent = objectives.ReturnScale(16), deque(maxlen=3)
cut = objectives.SequenceMinibatches(32, num_minibatches=4)
optimizer = torch.optim.Adam(policy.parameters(), 3e-4)
for batch in collect(env, policy, total_frames=4096 * given.batches):
    recent.append(batch.clone())
    loss.estimate_advantage(scale(batch))
    for part in (part for _ in range(4) for part in cut(batch)):
        found = loss(part)
        optimizer.zero_grad()
        sum(found[f"loss_{n}"] for n in ("objective", "critic", "entropy")).backward()
        torch.nn.utils.clip_grad_norm_(policy.parameters(), 0.5)
        optimizer.step()
    print(f"explorer: {count_squares(batch):.1f} squares, random: {usual:.1f}")

# What its last episodes saw becomes a map, finer than what is new: by half the views.
half = graph.calibrate_share(seen, target_share=0.5).threshold
least = graph.calibrate_reach(seen, tc_threshold=half).threshold
exact = {"window": 0, "search_window": 0, "nearby": 1, "shortlist": 1, "edges": "time"}
exact |= {"tc_threshold": half, "tc_reach": least, "untraversed_edge_cost": 10}
known = graph.TopologicalMap(network.embed, network.compare, graph.MapRules(**exact))
for episode in torch.cat([*recent]):
    known.add_episode(episode)
print(f"map: {known.num_waypoints:,} waypoints, {len(known.edges):,} edges")
goals = walks.reshape(-1)[torch.randint(walks.numel(), (64,))]
steps = {"shortlist": 2, "follow": 0, "lookahead": 2, "temperature": 0.5}
rules = graph.NavigatorRules(tc_reach=least, mask_noop_actions=True, **steps)
ours = walk_to(goals, graph.Navigator.over(known, head, rules=rules), given.seed + 1)
theirs = walk_to(goals, stroll, given.seed + 1)
for by in (64, 128, 192, 256):
    map_share, random = (share_arrived(walk, goals, by) for walk in (ours, theirs))
    print(f"after {by} decisions: by the map {map_share:.0%}, at random {random:.0%}")
