"""Explore a maze out of curiosity: the main job.

    python recipes/explore.py maze=maze3 reward.alpha=0.2
    python recipes/explore.py maze=maze1 pretrained=runs/pretrain/maze1-...
    python recipes/explore.py resume=runs/explore/maze3-...
    python recipes/explore.py -m maze=maze1,maze2,maze3 seed=0,1,2

First come networks that judge how close in time two views are: those of
``pretrained``, or of a pre-training with the same settings, or of one that starts
now. Then other processes walk the maze with the newest policy, paid for views that
are like none of their episode, and this one learns from what they did. The run folder
gets ``metrics.csv``, ``episodes.csv``, TensorBoard files, ``curves.png`` and
``map.png`` while it runs, ``policy.pt`` (the better paid of the best and the last),
``networks.pt``, ``evaluation.csv`` and ``episode.mp4`` at the end, and
``checkpoint.pt``, from which ``resume`` goes on. Meanwhile a topological map grows from
the same views: ``map.zip``, with ``topology.png``, ``map.csv`` that judges it, and
``map_poses.npy``, the truth about it that no agent reads.
"""

import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import torch
from tqdm import tqdm

from toponav.builders import (
    NETWORKS,
    NETWORKS_FILE,
    POLICY,
    CollectionError,
    EpisodeLog,
    ExplorationReport,
    Learner,
    Timer,
    collect_batches,
    evaluate_policies,
    keep_freed_memory,
    make_actor_critic,
    make_device,
    make_explore_collector,
    make_mailbox,
    make_map_growth,
    make_novelty,
    make_online_learning,
    make_walks,
    prepare_networks,
    pretraining_decisions,
    require_finite,
    save_exploration,
    save_networks,
    save_policy,
    start_exploration,
    stop_collector,
    summarize_evaluation,
    write_episode_video,
    write_evaluation,
)
from toponav.config import ExploreConfig
from toponav.evaluation import RandomPolicy, StickyPolicy
from toponav.launch import recipe

PRETRAIN = Path(__file__).with_name("pretrain.py")


@recipe("explore")
def main(settings: ExploreConfig, folder: Path) -> None:
    """Pre-train or find networks, explore, evaluate."""
    torch.set_num_threads(settings.threads or torch.get_num_threads())
    keep_freed_memory()

    # Networks that judge views: given, found or made. They bring their own model.
    networks = prepare_networks(settings, folder, PRETRAIN)
    settings = replace(settings, model=networks.model)
    novelty = make_novelty(networks, settings.reward)
    check = partial(require_finite, folder=folder)
    online = make_online_learning(
        settings, networks, check=partial(check, setting="online.lr")
    )

    # The explorer and what it learns with: fresh, or as they were at the cut.
    torch.manual_seed(settings.seed)
    policy = make_actor_critic(settings).to(make_device(settings.device))
    learner = Learner(settings, policy, check=partial(check, setting="loss.lr"))
    grown = make_map_growth(
        settings, networks, pretraining_decisions=pretraining_decisions(settings)
    )
    walks = make_walks(
        settings, networks, check=partial(check, setting="locomotion.lr")
    )
    parts = (learner, online, grown, walks)
    resume = settings.resume is not None
    state = start_exploration(folder, *parts, resume=resume)
    save = partial(save_exploration, folder, state, *parts)
    collect, every, maze = settings.collect, settings.report, settings.maze
    paid = "coverage" if settings.reward.kind == "coverage" else "intrinsic_return"

    # What walks that see nothing cover: the level that is to be beaten.
    if not state.evaluations:
        blind = {
            "random": RandomPolicy(seed=settings.seed),
            "sticky": StickyPolicy(seed=settings.seed),
        }
        walked = evaluate_policies(settings, novelty, blind)
        state.evaluations = write_evaluation(folder, walked)
        save()

    # Other processes explore, with weights from a mailbox.
    versions = {POLICY: state.policy_version, NETWORKS: state.networks_version}
    mailbox = make_mailbox(policy, novelty, versions=versions)
    collector = make_explore_collector(settings, mailbox, decisions=state.decisions)
    batches = collect_batches(collector, max_idle_s=collect.max_idle_s)
    log = EpisodeLog(collect.envs, maze.episode_length, state.episodes)
    bar = tqdm(
        desc="explore",
        total=collect.decisions,
        initial=state.decisions,
        unit="decision",
        smoothing=0.05,
    )
    report = ExplorationReport(settings, folder, state, log, bar)
    saving, drawing = Timer(every.save_every_s), Timer(every.pictures_every_s)
    started = time.monotonic() - state.seconds
    try:
        while state.progress(collect) < 1:
            # Collect what the others did with the policy of a moment ago.
            batch = next(batches)
            state.decisions += batch.numel()
            state.seconds = time.monotonic() - started
            ended = log.add(batch, state.decisions)

            # Learn from it; the others fetch the new policy before their next rollout.
            measured = learner.learn(batch, state.progress(collect))
            state.policy_version = mailbox.publish(POLICY, policy)
            if ended:
                state.consider(policy, paid, every.best_of)

            # The map grows from the same views, and the ways are kept.
            grown.add(batch, state.decisions)
            walks.add(batch)

            # The networks learn on, and now and then the others get a new version.
            if online is not None:
                losses, is_version_due = online.learn(batch)
                measured |= losses
                if is_version_due:
                    state.networks_version = mailbox.publish(NETWORKS, novelty)
                    grown.follow(state.networks_version)

            # Say, save, draw.
            is_last = state.progress(collect) == 1
            bar.update(batch.numel())
            report.add(measured, ended, lr=learner.lr)
            if report.is_due() or is_last:
                report.write_row()
            if saving.is_due() or is_last:
                save()
            if drawing.is_due() or is_last:
                report.draw()
                grown.write(folder, state.decisions)
    except (CollectionError, KeyboardInterrupt, SystemExit):
        save()
        raise
    finally:
        bar.close()
        stop_collector(collector)

    # The map as the last networks see it, sparse if wanted.
    grown.finish(folder, state.decisions)

    # The L-network learns to walk as the explorers did.
    walks.learn(folder)

    # Whole episodes of the best and of the last policy, judged by the truth. The one
    # that is paid more is kept: the best of a training owes something to luck.
    save_networks(networks, folder / NETWORKS_FILE)
    best = make_actor_critic(settings)
    best.load_state_dict(state.best_policy or policy.state_dict())
    explorers = {"best": best, "last": policy.cpu()}
    learned = evaluate_policies(settings, novelty, explorers)
    learned.sort(key=lambda one: one.mean(paid), reverse=True)
    save_policy(folder, explorers[learned[0].policy].state_dict())
    rows = write_evaluation(folder, learned, state.evaluations)
    write_episode_video(folder, maze, learned[0])
    print(summarize_evaluation(maze.name, rows))
    print(
        f"{state.decisions:,} decisions in {state.seconds / 60:.1f} minutes, "
        f"pre-training not included; written to {folder}"
    )


if __name__ == "__main__":
    main()
