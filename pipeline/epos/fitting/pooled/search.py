"""The search for poses (compiled): triplets, P3P, a look at a few pixels, a score, and local optimization of the promising."""

from typing import no_type_check

import numpy as np

from pipeline.epos.fitting.pooled.slots import agrees, offer, slot_at, weakest
from pipeline.epos.fitting.pooled.workspace import make_workspace, optimize, score
from pipeline.epos.fitting.primitives.blocks import LANES
from pipeline.epos.fitting.primitives.compiled import compiled, kernel
from pipeline.epos.fitting.primitives.hypothesis_log import KEPT, LOOKED_AT, OPTIMIZED, SCORED, note
from pipeline.epos.fitting.primitives.p3p import MAX_SOLUTIONS, solve_p3p
from pipeline.epos.fitting.primitives.poses import copy_pose, place_of
from pipeline.epos.fitting.primitives.projection import blocks_within, projection, window
from pipeline.epos.fitting.primitives.random_numbers import uniform
from pipeline.epos.fitting.primitives.sampling import load_triplet, make_sampler, sample_anywhere, sample_nearby
from pipeline.epos.fitting.primitives.scoring import quality

_FEW = 50
"""Draws after which the share of seeds without neighbours means something."""

_FIRST_POOL = 20
"""Correspondences that the first triplets are drawn from: of fewer, the same ones would vote for each other."""

_MIN_RADIUS_PX = 8.0
"""Objects that project smaller cannot contain a triangle worth sampling."""


@compiled()
@no_type_check
def explore(problem, weight, state, budget, slots, settings, counts, log):
    """Draw triplets, and keep the best poses in slots.

    Args:
        problem: the correspondences.
        weight: (b, 16) float32 weights of the pixels.
        state: of the random numbers.
        budget: number of draws.
        slots: changed.
        settings: of the search.
        counts: (4,) increased by the numbers of triplets, poses, poses scored and poses optimized.
        log: changed.

    Returns:
        True if the search was over before the budget was spent.

    """
    lens, rays, owner, radius = problem.lens, problem.rays, problem.owner, problem.radius
    uv, xyz, row, box, place = _arrays(problem.blocks)
    work = make_workspace(problem, weight)
    chosen, best = work.chosen, work.best
    poses, triplet, local = np.empty((MAX_SOLUTIONS, 3, 4)), np.empty(3, np.int64), np.empty(3, np.int64)
    triplet_rays, triplet_points = np.empty((3, 3)), np.empty((3, 3))
    sampler = make_sampler(problem, settings.nearest, settings.farthest)
    density, lonely = 0.0, 0
    for i in range(budget):
        limit = min(len(owner), _FIRST_POOL + len(owner) * (i + 1) // budget)
        anywhere = settings.anywhere if 2 * lonely <= i + _FEW else settings.anywhere_if_sparse
        if not _draw(sampler, limit, anywhere, settings.coherence, state, triplet):
            lonely += 1
            continue
        if not load_triplet(sampler, rays, triplet, settings.min_area, triplet_rays, triplet_points):
            continue
        counts[0] += 1
        nearby = _blocks_of(place, owner, triplet, local)
        floor = 3.0 + settings.early * density * nearby if density > 0.0 else 0.0
        for s in range(solve_p3p(triplet_rays, triplet_points, poses)):
            pose = poses[s]
            if lens[0, 0] * radius < _MIN_RADIUS_PX * pose[2, 3] or pose[2, 3] <= 0.0:
                continue
            counts[1] += 1
            raw, looked = _evaluate(
                lens, pose, radius, uv, xyz, row, box, weight, local[:nearby], floor, settings.raw_tau, chosen, best
            )
            if len(log.kind) > 0:
                note(log, triplet, pose, raw, LOOKED_AT if looked else SCORED)
            if looked:
                continue
            counts[2] += 1
            if _deserves(slots, pose, place_of(lens, pose, radius), raw):
                counts[3] += 1
                density = max(density, _improve(work, pose, triplet, raw, slots, settings, log))
        if settings.wanted > 0 and counts[0] >= settings.at_least and _is_done(slots, settings):
            return True
    return False


@compiled()
@no_type_check
def _arrays(blocks):
    """The arrays of the blocks; taken out before a loop, since handing over the whole costs as much as a score."""
    return blocks.uv, blocks.xyz, blocks.row, blocks.box, blocks.place


@kernel()
@no_type_check
def _draw(sampler, limit, anywhere, coherence, state, triplet):
    """Draw a triplet among the `limit` most confident; False where the seed has no neighbours."""
    if anywhere > 0.0 and uniform(state) < anywhere:
        sample_anywhere(sampler, limit, state, triplet)
        return True
    return sample_nearby(sampler, limit, coherence, state, triplet)


@kernel()
@no_type_check
def _evaluate(lens, pose, radius, uv, xyz, row, box, weight, local, floor, tau, chosen, best):
    """Quality of a pose and False; where it is below a floor in the blocks around its triplet, that quality and True."""
    p, inverse = projection(lens, pose), np.float32(1.0 / (tau * tau))
    if floor > 0.0:
        look = quality(p, uv, xyz, row, weight, inverse, local, best)
        if look < floor:
            return look, True
    within = blocks_within(box, window(lens, pose, radius, tau), chosen)
    return quality(p, uv, xyz, row, weight, inverse, chosen[:within], best), False


@kernel()
@no_type_check
def _improve(work, pose, triplet, raw, slots, settings, log):
    """Optimize a pose and offer it to the slots; return its quality per block if it was kept, else 0."""
    trial = work.trial
    copy_pose(pose, trial)
    if not optimize(work, trial, settings.first_tau, settings.tau, settings.steps) or trial[2, 3] <= 0.0:
        return 0.0
    q, within = score(work, trial, settings.tau)
    kept = offer(slots, trial, q, place_of(work.lens, trial, work.radius), raw)
    note(log, triplet, trial, q, KEPT if kept else OPTIMIZED)
    return q / within if kept else 0.0


@kernel()
@no_type_check
def _deserves(slots, pose, place, raw):
    """Tell whether a hypothesis is good enough at its place to be optimized; it may agree with the slot's pose, too."""
    k = slot_at(slots, place[0], place[1])
    if k < 0:
        return raw > slots.quality[weakest(slots)]
    if 2.0 * raw > slots.quality[k] and agrees(slots, k, pose):
        slots.votes[k] += 1
    if raw <= slots.bar[k]:
        return False
    slots.bar[k] = raw
    return True


@kernel()
@no_type_check
def _is_done(slots, settings):
    """Tell whether as many slots as wanted are settled, or the quality of one is enough."""
    settled = 0
    for k in range(len(slots.votes)):
        settled += slots.votes[k] >= settings.votes
        if slots.quality[k] >= settings.enough:
            return True
    return settled >= settings.wanted


@kernel()
@no_type_check
def _blocks_of(place, owner, triplet, blocks):
    """Write the different blocks that three correspondences lie in; return their number."""
    count = 0
    for k in range(3):
        block = place[owner[triplet[k]]] // LANES
        if count == 0 or (block != blocks[0] and (count == 1 or block != blocks[1])):
            blocks[count] = block
            count += 1
    return count
