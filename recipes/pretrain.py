"""Train the TC-network and the L-network on random walks.

    python recipes/pretrain.py maze=select
    python recipes/pretrain.py mazes=[maze1,maze2,maze3]
    python recipes/pretrain.py maze=maze1 init_from=runs/pretrain/select-...
    python recipes/pretrain.py maze=maze1 init_from=runs/... train.updates=0
    python recipes/pretrain.py resume=runs/pretrain/select-...

Other processes walk at random, this one learns from their frames: which views are
close in time (TC), and which action leads from one to the other (L). The run folder
gets ``networks.pt`` (both networks and their thresholds), ``metrics.csv``,
``curves.png``, TensorBoard files, ``walk.png`` (a map that the networks make of a
random walk, while they learn), a report (``report.json``, and ``report.png`` in a
world with ground truth) and ``checkpoint.pt``, from which ``resume`` continues.
"""

from toponav.interrupts import catch_early

catch_early(__name__)

import sys
import time
from pathlib import Path

from tqdm import tqdm

from toponav.builders import (
    FRAME_KEYS,
    NETWORKS_FILE,
    CollectionError,
    ThreadGuard,
    collect_frames,
    collect_held_out,
    keep_layout,
    make_autocast,
    make_device,
    make_frame_buffer,
    prepare_process,
    save_networks,
    start_networks,
    taken_meanwhile,
)
from toponav.config import PretrainConfig
from toponav.launch import recipe
from toponav.methods import make_worlds
from toponav.reports import (
    PRETRAIN,
    is_waited_for,
    pretrain_schedule,
    pretrained_share,
    progress_figures,
    summarize,
    write_measurements,
    write_reports,
    write_walk_map,
)
from toponav.runs import (
    CONTINUES,
    StoppedError,
    make_loggers,
    stop_requests,
    write_history,
)
from toponav.training import (
    Validation,
    decisions_due,
    make_pretrainer,
    require_pretrain_room,
    restore_training,
    save_training,
)


@recipe("pretrain")
def main(settings: PretrainConfig, folder: Path) -> None:
    """Collect, train, validate, calibrate, report."""
    schedule = pretrain_schedule()
    train, worlds, started = settings.train, make_worlds(settings), time.monotonic()
    prepare_process(threads=train.threads, seed=settings.seed)
    device = make_device(settings.device)
    autocast = make_autocast(device, bf16=train.bf16)

    # Fresh networks, or those of an earlier run, and what trains them.
    world = worlds[0].spec
    networks = start_networks(settings.model, world, settings.init_from, device=device)
    require_pretrain_room(settings, worlds, networks.modules, folder)
    keep_layout(folder, settings.maze, worlds[0].layout)
    buffer, threads = make_frame_buffer(settings, world), ThreadGuard()
    trainer = make_pretrainer(
        settings, networks, buffer.storage, autocast=autocast, folder=folder
    )
    history = restore_training(folder, networks, trainer) if settings.resume else []
    if settings.resume and trainer.updates < train.updates:
        # The report of a run that was over is of fewer updates, and not of it all.
        (folder / "report.json").unlink(missing_ok=True)
    started -= history[-1]["seconds"] if history else 0.0

    before = trainer.updates
    schedule.begin(PRETRAIN, rest=1 - before / max(train.updates, 1))

    loggers = make_loggers(folder, before)
    decisions, saved = 0, time.monotonic()

    def measure() -> dict[str, float]:
        seconds = time.monotonic() - started
        counts = {"update": trainer.updates, "decisions": decisions, "seconds": seconds}
        return counts | validate()

    # An exploration that waits is started again itself, and says how it ended.
    with stop_requests(None if is_waited_for() else CONTINUES) as stop:
        try:
            with (
                collect_frames(
                    settings, worlds, needed=trainer.updates < train.updates
                ) as collected,
                tqdm(
                    total=train.updates, initial=trainer.updates, unit="update"
                ) as bar,
            ):
                # Episodes that no training sees, to validate on, while the first
                # decisions are collected.
                with taken_meanwhile(collected, settings.collect.ahead) as batches:
                    held_out = collect_held_out(settings, worlds, progress=stop.check)
                validate = Validation(networks, settings, held_out, autocast=autocast)

                def show_map() -> str | None:
                    progress = f"{trainer.updates:,} of {train.updates:,} updates"
                    return write_walk_map(folder, validate, worlds[0], progress)

                # Of networks that know nothing yet, to compare with.
                if (shown := show_map()) is not None:
                    said = f"{' '.join(shown.split())} ({folder / 'walk.png'})"
                    tqdm.write(said, file=sys.stderr)
                while trainer.updates < train.updates and not stop.requested:
                    # Collect the decisions that are due before this update.
                    if decisions < decisions_due(settings, trainer.updates):
                        bar.set_description(f"collect, {decisions:,} decisions")
                        batch = next(batches).flatten().select(*FRAME_KEYS)
                        buffer.extend(batch)
                        decisions += len(batch)
                        continue

                    # Train on pairs of all frames so far.
                    with threads.watch():
                        losses = trainer.step()
                    bar.set_description("train", refresh=False)
                    bar.update()
                    is_last = trainer.updates == train.updates
                    done = (trainer.updates - before) / (train.updates - before)
                    schedule.show(pretrained_share(done))

                    # Measure on the held-out episodes.
                    if is_last or trainer.updates % settings.validate.every == 0:
                        bar.set_description("validate")
                        history.append(measure() | losses)
                        write_measurements(folder, loggers, history)
                        show_map()
                        bar.set_postfix(progress_figures(history[-1]))

                    # Save, now and then and at the end.
                    if is_last or time.monotonic() - saved > train.save_every_s:
                        save_training(folder, networks, trainer, history)
                        saved = time.monotonic()
        except (CollectionError, StoppedError):
            save_training(folder, networks, trainer, history)
            if not stop.requested:
                raise
        if stop.requested:
            save_training(folder, networks, trainer, history)
    if not history:  # Only the networks of `init_from` are to be measured.
        write_history(folder / "metrics.csv", [measure()])

    # Thresholds from random walks, the report against the ground truth, the networks.
    figures = write_reports(folder, validate, worlds, settings)
    save_networks(networks, folder / NETWORKS_FILE)
    print(summarize(figures, networks))
    minutes = (time.monotonic() - started) / 60
    counts = f"{settings.collect.decisions:,} decisions, {train.updates:,} updates"
    print(f"{counts} in {minutes:.1f} minutes; written to {folder}")


if __name__ == "__main__":
    main()
