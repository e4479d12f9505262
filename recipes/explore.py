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
``map.png`` while it runs, ``policy.pt`` (the best by intrinsic return),
``networks.pt``, ``evaluation.csv`` and ``episode.mp4`` at the end, and
``checkpoint.pt``, from which ``resume`` goes on.
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
    ExplorationState,
    Learner,
    Means,
    OnlineLearning,
    Row,
    collect_batches,
    evaluate_policies,
    keep_freed_memory,
    make_actor_critic,
    make_device,
    make_explore_collector,
    make_loggers,
    make_mailbox,
    make_metrics,
    make_novelty,
    prepare_networks,
    require_finite,
    restore_exploration,
    save_exploration,
    save_networks,
    summarize_evaluation,
    write_episode_video,
    write_evaluation,
    write_map,
    write_metrics,
    write_training_curves,
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
    device = make_device(settings.device)

    # The networks that judge views; what they were made with goes before settings.
    networks = prepare_networks(settings, folder, PRETRAIN)
    settings = replace(settings, model=networks.model)
    novelty = make_novelty(networks, settings.reward)
    online = OnlineLearning(settings, networks) if settings.online.learn else None

    # The explorer and what it learns with: fresh, or as they were at the cut.
    torch.manual_seed(settings.seed)
    policy = make_actor_critic(settings).to(device)
    check = partial(require_finite, folder=folder, setting="loss.lr")
    learner = Learner(settings, policy, check=check)
    state = ExplorationState()
    if settings.resume:
        state = restore_exploration(folder, learner, online)
    save = partial(save_exploration, folder, state, learner, online)
    collect, every, maze = settings.collect, settings.report, settings.maze
    paid = "coverage" if settings.reward.kind == "coverage" else "intrinsic_return"

    # What walks that see nothing cover: the level that is to be beaten.
    if not state.evaluations:
        walks = {
            "random": RandomPolicy(seed=settings.seed),
            "sticky": StickyPolicy(seed=settings.seed),
        }
        walked = evaluate_policies(settings, novelty, walks)
        state.evaluations = write_evaluation(folder, walked)
        save()

    # Other processes explore, with weights from a mailbox.
    versions = {POLICY: state.policy_version, NETWORKS: state.networks_version}
    mailbox = make_mailbox(policy, novelty, versions=versions)
    collector = make_explore_collector(settings, mailbox, decisions=state.decisions)
    batches = collect_batches(collector, max_idle_s=collect.max_idle_s)
    log = EpisodeLog(collect.envs, maze.episode_length, state.episodes)
    state.episodes = log.rows
    loggers, means, ended = make_loggers(folder), Means(), list[Row]()

    def progress() -> float:
        """How much of the run is over, by decisions or by the clock."""
        by_clock = state.seconds / (60 * collect.minutes) if collect.minutes else 0.0
        return min(1.0, max(state.decisions / collect.decisions, by_clock))

    def report() -> None:
        """Write a row of metrics and put its gist on the live line."""
        last = state.history[-1] if state.history else {"decisions": 0, "seconds": 0.0}
        rate = (state.decisions - last["decisions"]) / (state.seconds - last["seconds"])
        counts = {
            "decisions": state.decisions,
            "seconds": state.seconds,
            "decisions_per_second": rate,
            "lr": learner.lr,
            "policy_version": state.policy_version,
            "networks_version": state.networks_version,
        }
        row = make_metrics(counts, ended, log.rows, means.take())
        state.history.append(row)
        write_metrics(folder, loggers, state.history, log.rows)
        ended.clear()
        bar.set_postfix(
            coverage=f"{row['coverage']:.0%}",
            waypoints=f"{row['waypoints']:.0f}",
            intrinsic=f"{row['intrinsic_return']:.0f}",
            objective=f"{row['loss_objective']:.3f}",
            critic=f"{row['loss_critic']:.3f}",
            entropy=f"{row['entropy']:.2f}",
        )

    def draw() -> None:
        """Renew the pictures."""
        write_training_curves(
            folder, state.history, log.rows, levels=state.levels, title=maze.name
        )
        if log.last_episode is not None:
            write_map(folder, maze, log.last_episode)

    bar = tqdm(
        desc="explore",
        total=collect.decisions,
        initial=state.decisions,
        unit="decision",
        smoothing=0.05,
    )
    saved = drawn = time.monotonic()
    started = saved - state.seconds
    try:
        while progress() < 1:
            # Collect what the others did with the policy of a moment ago.
            batch = next(batches)
            state.decisions += batch.numel()
            state.seconds = time.monotonic() - started
            finished = log.add(batch, state.decisions)
            ended += finished

            # Learn from it; the others fetch the new policy before their next rollout.
            means.add(learner.learn(batch, progress()))
            state.policy_version = mailbox.publish(POLICY, policy)
            if finished:
                state.consider(policy, paid, every.best_of)

            # The networks learn on, and now and then the others get a new version.
            if online is not None:
                online.add(batch)
                while online.is_due():
                    means.add(online.update())
                if online.is_version_due():
                    state.networks_version = mailbox.publish(NETWORKS, novelty)

            # Say, save, draw.
            bar.update(batch.numel())
            reported = state.history[-1]["decisions"] if state.history else 0
            if state.decisions - reported >= every.every or progress() == 1:
                report()
            now = time.monotonic()
            if now - saved > every.save_every_s or progress() == 1:
                save()
                saved = now
            if now - drawn > every.pictures_every_s or progress() == 1:
                draw()
                drawn = time.monotonic()
    except (CollectionError, KeyboardInterrupt, SystemExit):
        save()
        raise
    finally:
        bar.close()
        collector.shutdown(raise_on_error=False)

    # Whole episodes of the best and of the last policy, judged by the truth.
    save_networks(networks, folder / NETWORKS_FILE)
    best = make_actor_critic(settings)
    best.load_state_dict(state.best_policy or policy.state_dict())
    learned = evaluate_policies(settings, novelty, {"best": best, "last": policy.cpu()})
    rows = write_evaluation(folder, learned, state.evaluations)
    write_episode_video(folder, maze, learned[0])
    print(summarize_evaluation(maze.name, rows))
    print(
        f"{state.decisions:,} decisions in {state.seconds / 60:.1f} minutes, "
        f"pre-training not included; written to {folder}"
    )


if __name__ == "__main__":
    main()
