"""What a lab writes in place of `dermis fusion`: numpy and scipy, vectorised over all contacts of all skins.

Reports of the same moment are worked in together, with one pass of array operations over the whole body. Estimator, gates, costs
and assignment are those of `nodes/fusion`, so that both make the same of the same reports: a Schmidt-Kalman filter of position and
velocity and one of force for each contact, global nearest neighbours by `linear_sum_assignment`, birth after two reports, death
after a hold, merging of what two skins feel. Units are SI; stamps are integer nanoseconds.

Left out, so that less is computed here than there: reports that overtake each other, outliers of a skin, contacts without a place,
slip, what is expected or the robot's own, and torques that no contact explains. Two publishers of one skin or a flood are not
noticed.
"""

import numpy as np
from body_robot import Joints, apply, cross, swap
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

# Of `nodes/fusion/src/settings.rs`, `group.rs` and `track.rs`.
GATE, SLIDE_SPEED, SLIDE_TIME, FORCE_CHANGE = 16.27, 0.05, 0.1, 20.0
MOUNT, SHARE, GAIN, BIRTHS, HOLD = 1e-3, 0.5, 0.03, 2, 0.05
UNKNOWN_POSITION, UNKNOWN_FORCE = 5e-3, 0.5
SWITCH, CONTRADICTION, MERGE_GATE, HOLD_PERIODS, LONGEST_PERIOD = 6.0, 20.0, 7.81, 2.5, 0.4
UNMEASURED, KNOWN, LEAST = 1e6, 1e4, 1e-8
LONGEST_LAG = 0.1
FORCE_NORMAL, FORCE_FULL = 1, 2
EYE = np.eye(3)


class Report:
    """Contacts of one frame of one skin: `stamp` [ns], identities (n), positions, normals, forces (n, 3), covariances (n, 3, 3)."""

    __slots__ = ("skin", "stamp", "ids", "position", "normal", "force", "place_noise", "force_noise", "components")

    def __init__(self, skin, stamp, ids, position, normal, force, place_noise, force_noise, components):
        self.skin, self.stamp, self.ids, self.components = skin, stamp, ids, components
        self.position, self.normal, self.force = position, normal, force
        self.place_noise, self.force_noise = place_noise, force_noise


def slide(dt):
    """Of an Ornstein-Uhlenbeck velocity over dt (n): what it adds to the position, its decay, and the noise of p p, p v, v v."""
    x = dt / SLIDE_TIME
    decay, lost, variance = np.exp(-x), -np.expm1(-x), SLIDE_SPEED**2
    # For short steps the terms of the exact form cancel.
    spread = np.where(x < 1e-3, x**3 * (2 / 3 - x / 2), 2 * x - 3 + 4 * decay - decay * decay)
    tau = SLIDE_TIME
    return tau * lost, decay, variance * tau * tau * spread, variance * tau * lost * lost, variance * (1 - decay * decay)


def predict(dt, mean, covariance, force_covariance, crossed=None):
    """Takes filters of n contacts on by dt (n) [s], in place; `crossed` is the covariance with biases (n, slots, 6, 3)."""
    a, d, pp, pv, vv = (v[:, None, None] for v in slide(dt))
    mean[:, :3] += a[:, 0] * mean[:, 3:]
    mean[:, 3:] *= d[:, 0]
    p, across, v = covariance[:, :3, :3], covariance[:, :3, 3:], covariance[:, 3:, 3:]
    carried = across + a * v
    p += a * (swap(across) + carried) + pp * EYE
    across[:] = d * carried + pv * EYE
    covariance[:, 3:, :3] = swap(across)
    v *= d * d
    v += vv * EYE
    if crossed is not None:
        crossed[:, :, :3] += a[:, None] * crossed[:, :, 3:]
        crossed[:, :, 3:] *= d[:, None]
    force_covariance += (FORCE_CHANGE**2 * dt)[:, None, None] * EYE


def update(state, covariance, crossed, rows, slot, reading, innovation):
    """Schmidt-Kalman update of some rows: `reading` is value and bias, `innovation` its covariance and the inverse of that."""
    value, bias = reading
    spread, inverted = innovation
    own = crossed[rows, slot]
    before = covariance[rows]
    gain = (before[:, :, :3] + own) @ inverted
    state[rows] += apply(gain, value - state[rows, :3])
    after = before - gain @ spread @ swap(gain)
    covariance[rows] = (after + swap(after)) * 0.5
    moved = crossed[rows, :, :3]
    moved[np.arange(len(rows)), slot] += bias
    crossed[rows] -= gain[:, None] @ moved


class BodyFusion:
    """Contacts of a body. Arrays hold one row a contact, and along a second axis one place for each skin of its group."""

    def __init__(self, robot, assume_rest=False):
        self.robot, self.joints = robot, Joints(robot, assume_rest)
        s, skins = robot.slots, len(robot.skins)
        self.rows = {
            "group": np.zeros(0, int), "id": np.zeros(0, int), "hits": np.zeros(0, int),
            "at": np.zeros(0, np.int64), "born": np.zeros(0, np.int64), "seen": np.zeros(0, np.int64),
            "mean": np.zeros((0, 6)), "covariance": np.zeros((0, 6, 6)), "crossed": np.zeros((0, s, 6, 3)),
            "force": np.zeros((0, 3)), "force_covariance": np.zeros((0, 3, 3)), "force_crossed": np.zeros((0, s, 3, 3)),
            # Of skins: whether they feel it, what they call it, when they said so last; the biases that are in the filters.
            "feels": np.zeros((0, s), bool), "called": np.zeros((0, s), int), "heard": np.zeros((0, s), np.int64),
            "biased": np.zeros((0, s), bool), "bias": np.zeros((0, s, 3, 3)), "force_bias": np.zeros((0, s, 3, 3)),
            "normal": np.zeros((0, s, 3)), "spread": np.full((0, s), np.inf), "components": np.zeros((0, s), int),
        }  # fmt: skip
        self.last = np.zeros(skins, np.int64)
        self.came = np.zeros(skins, np.int64)
        self.period = np.zeros(skins)
        self.group_at = np.zeros(len(robot.skin_at), np.int64)
        # Contacts are merged only of skins that share their group with another one.
        self.shared = np.bincount(robot.group)[robot.group] > 1
        self.identities = 0

    def take(self, reports, now):
        """Works in reports that came at `now`, in the order of acquisition; together where skins are not rigidly connected."""
        reports = sorted(reports, key=lambda report: report.stamp)
        while reports:
            batch, later, groups = [], [], set()
            for report in reports:
                group = self.robot.group[report.skin]
                (later if group in groups else batch).append(report)
                groups.add(group)
            self._work(batch, now)
            reports = later

    def _work(self, reports, now):
        robot, rows = self.robot, self.rows
        skins = np.array([report.skin for report in reports])
        groups, slots = robot.group[skins], robot.slot[skins]
        # What comes late counts as of now.
        stamps = np.maximum([report.stamp for report in reports], self.group_at[groups])
        self._note(skins, stamps, now)
        if len(rows["id"]):
            at = np.zeros(len(self.group_at), np.int64)
            at[groups] = stamps
            later = np.maximum(at[rows["group"]], rows["at"])
            if (later > rows["at"]).any():
                filters = (rows["mean"], rows["covariance"], rows["force_covariance"], rows["crossed"])
                predict((later - rows["at"]) * 1e-9, *filters)
                rows["at"] = later
        d = self._detections(reports, skins, stamps)
        begun = np.ones(len(d["id"]), bool)
        if len(begun) and len(rows["id"]):
            taken = self._associate(d)
            begun[taken] = False
        if begun.any():
            self._begin({key: value[begun] for key, value in d.items()})
            rows = self.rows
        self._end(groups, slots, skins, stamps)
        if self.shared[skins].any():
            for group, slot, stamp, shared in zip(groups, slots, stamps, self.shared[skins]):
                while shared and self._merge(group, slot, stamp):
                    pass

    def _note(self, skins, stamps, now):
        """How often skins report."""
        step = np.minimum((stamps - self.last[skins]) * 1e-9, LONGEST_PERIOD)
        before = self.period[skins]
        smoothed = np.where(before == 0.0, step, before + 0.1 * (step - before))
        self.period[skins] = np.where(self.last[skins] == 0, 0.0, smoothed)
        self.last[skins], self.came[skins] = stamps, now
        self.group_at[self.robot.group[skins]] = stamps

    def _detections(self, reports, skins, stamps):
        """All contacts of the reports, as readings in the frames in which contacts are kept."""
        counts = [len(report.ids) for report in reports]
        of = np.repeat(np.arange(len(reports)), counts)
        join = lambda key: np.concatenate([getattr(report, key) for report in reports])  # noqa: E731
        top = self.robot.top_from_skin[skins[of]]
        turn, back = top[:, :3, :3], swap(top[:, :3, :3])
        normal, components = join("normal"), join("components")
        normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
        said = join("place_noise")
        said = np.where(np.isfinite(said).all((1, 2), keepdims=True), said, EYE * UNKNOWN_POSITION**2)
        place = turn @ ((said + swap(said)) * 0.5 + EYE * LEAST) @ back
        force, noise, bias = self._forces(join("force"), join("force_noise"), normal, components)
        return {
            "skin": skins[of], "group": self.robot.group[skins[of]], "slot": self.robot.slot[skins[of]],
            "stamp": stamps[of], "id": join("ids"), "components": components, "normal": apply(turn, normal),
            "place": apply(turn, join("position")) + top[:, :3, 3],
            "noise": place * (1 - SHARE), "bias": place * SHARE + EYE * MOUNT**2,
            "force": apply(turn, force), "force_noise": turn @ noise @ back, "force_bias": turn @ bias @ back,
        }  # fmt: skip

    @staticmethod
    def _forces(force, said, normal, components):
        """Forces, what is new in each reading, and what stays, of skins that measure all of it, its normal part, or nothing."""
        said = np.where(np.isfinite(said).all((1, 2), keepdims=True), said, EYE * UNKNOWN_FORCE**2)
        full = (components == FORCE_FULL)[:, None]
        if full.all():
            said = (said + swap(said)) * 0.5 + EYE * LEAST
            return force, said * (1 - SHARE), said * SHARE + EYE * ((GAIN * force) ** 2)[:, None, :]
        all_of_it = (said + swap(said)) * 0.5 + EYE * LEAST
        gain = EYE * ((GAIN * force) ** 2)[:, None, :]
        along = np.where((components == FORCE_NORMAL), np.sum(force * normal, axis=1), 0.0)
        variance = np.einsum("ni,nij,nj->n", normal, said, normal)
        axis = normal[:, :, None] * normal[:, None, :]
        measured = np.where(components == FORCE_NORMAL, variance * (1 - SHARE) + LEAST, UNMEASURED)[:, None, None]
        noise = axis * measured + (EYE - axis) * UNMEASURED
        stays = np.where(components == FORCE_NORMAL, variance * SHARE + (GAIN * along) ** 2, 0.0)[:, None, None]
        wide = full[:, :, None]
        return (
            np.where(full, force, normal * along[:, None]),
            np.where(wide, all_of_it * (1 - SHARE), noise),
            np.where(wide, all_of_it * SHARE + gain, axis * stays),
        )

    def _normals(self):
        weight = np.where(self.rows["feels"], 1.0 / self.rows["spread"], 0.0)
        total = (self.rows["normal"] * weight[:, :, None]).sum(1)
        return total / np.linalg.norm(total, axis=1, keepdims=True)

    def _pairs(self, d):
        """Readings and contacts that can be one: indices of both, bias, covariance of the innovation and its inverse, cost."""
        rows = self.rows
        own = rows["feels"][:, d["slot"]].T & (rows["called"][:, d["slot"]].T == d["id"][:, None])
        together = d["group"][:, None] == rows["group"]
        own &= together & (d["id"] != 0)[:, None]
        # Most pairs end here: the largest eigenvalue of a covariance is below its trace, and a bias counts twice at most.
        trace = lambda m: np.trace(m, axis1=1, axis2=2)  # noqa: E731
        reach = 2 * GATE * (2 * trace(rows["covariance"][:, :3, :3]) + (trace(d["noise"]) + 2 * trace(d["bias"])).max())
        i, t = np.nonzero((cdist(d["place"], rows["mean"][:, :3], "sqeuclidean") <= reach) & together)
        near = np.sum(self._normals()[t] * d["normal"][i], axis=1) > 0
        i, t = i[near], t[near]
        slot = d["slot"][i]
        crossed = rows["crossed"][t, slot, :3]
        bias = np.where(rows["biased"][t, slot][:, None, None], rows["bias"][t, slot], d["bias"][i])
        spread = rows["covariance"][t, :3, :3] + crossed + swap(crossed) + bias + d["noise"][i]
        inverted = np.linalg.inv(spread)
        off = d["place"][i] - rows["mean"][t, :3]
        distance = np.sum(off * apply(inverted, off), axis=1)
        felt, same = rows["feels"][t, slot], own[i, t]
        inside = distance <= np.where(felt, 2 * GATE, GATE)
        doubt = np.log(np.linalg.det(spread) / np.linalg.det(d["noise"] + d["bias"])[i])
        cost = distance + np.maximum(doubt, 0.0) + SWITCH * (rows["hits"][t] < BIRTHS)
        other = felt & ~same
        if other.any():
            # The skin takes it for another one, or tells the two apart.
            names = np.isin(d["skin"][i] << 32 | rows["called"][t, slot], d["skin"] << 32 | d["id"])
            cost += np.where(other, np.where(names, CONTRADICTION, SWITCH), 0.0)
        # The skin means another contact.
        cost += SWITCH * (own.any(1)[i] & ~same)
        return [values[inside] for values in (i, t, bias, spread, inverted, cost)]

    def _associate(self, d):
        """Takes readings for contacts, none of one skin for the same; which ones."""
        rows = self.rows
        i, t, bias, spread, inverted, cost = self._pairs(d)
        lone = (np.bincount(i, minlength=len(d["id"]))[i] == 1) & (np.bincount(t, minlength=len(rows["id"]))[t] == 1)
        chosen = np.nonzero(lone)[0]
        if len(chosen) < len(i):
            rest = np.nonzero(~lone)[0]
            (_, r), (columns, c) = np.unique(i[rest], return_inverse=True), np.unique(t[rest], return_inverse=True)
            count = r.max() + 1
            costs = np.full((count, len(columns) + count), 1e4)
            costs[r, c] = cost[rest]
            # Each reading may begin a contact instead.
            costs[np.arange(count), len(columns) + np.arange(count)] = GATE + CONTRADICTION + 2 * SWITCH
            best = linear_sum_assignment(costs)[1]
            chosen = np.concatenate([chosen, rest[best[r] == c]])
        i, t, bias, spread, inverted = (values[chosen] for values in (i, t, bias, spread, inverted))
        slot = d["slot"][i]
        place = (d["place"][i], bias)
        update(rows["mean"], rows["covariance"], rows["crossed"], t, slot, place, (spread, inverted))
        crossed = rows["force_crossed"][t, slot]
        force_bias = np.where(rows["biased"][t, slot][:, None, None], rows["force_bias"][t, slot], d["force_bias"][i])
        spread = rows["force_covariance"][t] + crossed + swap(crossed) + force_bias + d["force_noise"][i]
        force = (d["force"][i], force_bias)
        innovation = (spread, np.linalg.inv(spread))
        update(rows["force"], rows["force_covariance"], rows["force_crossed"], t, slot, force, innovation)
        rows["bias"][t, slot], rows["force_bias"][t, slot], rows["biased"][t, slot] = bias, force_bias, True
        rows["hits"][t] += 1
        self._hear(t, d, i)
        return i

    def _hear(self, t, d, i):
        rows, slot = self.rows, d["slot"][i]
        rows["seen"][t], rows["heard"][t, slot], rows["feels"][t, slot] = d["stamp"][i], d["stamp"][i], True
        rows["called"][t, slot], rows["normal"][t, slot] = d["id"][i], d["normal"][i]
        rows["spread"][t, slot] = np.trace(d["noise"][i] + d["bias"][i], axis1=1, axis2=2)
        rows["components"][t, slot] = d["components"][i]

    def _begin(self, d):
        """Contacts from readings that no contact can be."""
        first, count = len(self.rows["id"]), len(d["id"])
        # Where a skin takes a new place for a contact that it felt elsewhere, the contact is not there any more.
        if first:
            rows = self.rows
            moved = (rows["group"][:, None] == d["group"]) & rows["feels"][:, d["slot"]]
            moved &= (rows["called"][:, d["slot"]] == d["id"]) & (rows["heard"][:, d["slot"]] != d["stamp"])
            t, i = np.nonzero(moved)
            rows["feels"][t, d["slot"][i]] = False
        self.rows = {
            key: np.concatenate([old, np.zeros((count, *old.shape[1:]), old.dtype)]) for key, old in self.rows.items()
        }
        rows, t, slot = self.rows, np.arange(first, first + count), d["slot"]
        rows["group"][t], rows["at"][t], rows["born"][t], rows["hits"][t] = d["group"], d["stamp"], d["stamp"], 1
        rows["spread"][t] = np.inf
        rows["mean"][t, :3] = d["place"]
        rows["covariance"][t] = np.eye(6) * SLIDE_SPEED**2
        rows["covariance"][first:, :3, :3] = d["noise"] + d["bias"]
        # The error of the mean is -(b + v).
        rows["crossed"][t, slot, :3] = -d["bias"]
        rows["force"][t], rows["force_covariance"][t] = d["force"], d["force_noise"] + d["force_bias"]
        rows["force_crossed"][t, slot] = -d["force_bias"]
        rows["bias"][t, slot], rows["force_bias"][t, slot], rows["biased"][t, slot] = d["bias"], d["force_bias"], True
        self._hear(t, d, np.arange(count))

    def _keep(self, mask):
        if not mask.all():
            self.rows = {key: values[mask] for key, values in self.rows.items()}

    def _end(self, groups, slots, skins, stamps):
        """Contacts end that skins have not felt for a while."""
        rows = self.rows
        limit = np.zeros((len(self.group_at), self.robot.slots), np.int64)
        hold = np.maximum(HOLD, HOLD_PERIODS * self.period[skins])
        limit[groups, slots] = stamps - (hold * 1e9).astype(np.int64)
        rows["feels"] &= rows["heard"] >= limit[rows["group"]]
        self._keep(rows["feels"].any(1))

    def _merge(self, group, slot, stamp):
        """Makes one of two contacts that no skin feels both, and that are in one place; whether there were any."""
        rows = self.rows
        settled = (rows["group"] == group) & (rows["hits"] >= BIRTHS)
        touched = np.nonzero(settled & rows["feels"][:, slot] & (rows["seen"] == stamp))[0]
        others = np.nonzero(settled & ~rows["feels"][:, slot])[0]
        if not len(touched) or not len(others):
            return False
        off = rows["mean"][touched, None, :3] - rows["mean"][others, :3]
        total = rows["covariance"][touched, None, :3, :3] + rows["covariance"][others, :3, :3]
        normals = self._normals()
        alike = np.sum(off * apply(np.linalg.inv(total), off), axis=2) <= MERGE_GATE
        alike &= (normals[touched] @ normals[others].T > 0) & ~(rows["feels"][touched, None] & rows["feels"][others]).any(2)
        found = np.argwhere(alike)
        if not len(found):
            return False
        a, b = touched[found[0, 0]], others[found[0, 1]]
        rank = lambda t: (rows["id"][t] == 0, rows["id"][t], rows["born"][t])  # noqa: E731
        keep, gone = (b, a) if rank(b) < rank(a) else (a, b)
        for state, covariance, crossed, bias in (
            ("mean", "covariance", "crossed", "bias"),
            ("force", "force_covariance", "force_crossed", "force_bias"),
        ):
            x, p, c = rows[state], rows[covariance], rows[crossed]
            of_gone = p[keep] @ np.linalg.inv(p[keep] + p[gone])
            of_keep = np.eye(len(of_gone)) - of_gone
            x[keep] = of_keep @ x[keep] + of_gone @ x[gone]
            p[keep] = of_keep @ p[keep]
            p[keep] = (p[keep] + p[keep].T) * 0.5
            new = (rows["biased"][gone] & ~rows["biased"][keep])[:, None, None]
            c[keep] = np.where(new, of_gone @ c[gone], of_keep @ c[keep])
            rows[bias][keep] = np.where(new, rows[bias][gone], rows[bias][keep])
        rows["biased"][keep] |= rows["biased"][gone]
        feels = rows["feels"][gone]
        for key in ("called", "heard", "normal", "spread", "components", "feels"):
            rows[key][keep, feels] = rows[key][gone, feels]
        rows["id"][keep] = rows["id"][keep] or rows["id"][gone]
        rows["born"][keep] = min(rows["born"][keep], rows["born"][gone])
        rows["hits"][keep] = max(rows["hits"][keep], rows["hits"][gone])
        self._keep(np.arange(len(rows["id"])) != gone)
        return True

    def state(self, now):
        """What the body feels at `now` [ns]: arrays with a row for each contact, link with skins, skin and joint."""
        robot = self.robot
        stale = (self.came == 0) | ((now - self.came) * 1e-9 > robot.timeouts)
        if stale.any() and len(self.rows["id"]):
            deaf = np.zeros((len(self.group_at), robot.slots), bool)
            deaf[robot.group, robot.slot] = stale
            self.rows["feels"] &= ~deaf[self.rows["group"]]
            self._keep(self.rows["feels"].any(1))
        rows = self.rows
        newest = int(self.last.max())
        stamp = newest if (now - newest) * 1e-9 <= LONGEST_LAG else now
        shown = rows["hits"] >= BIRTHS
        for t in np.nonzero(shown & (rows["id"] == 0))[0]:
            self.identities += 1
            rows["id"][t] = self.identities
        at = lambda key: rows[key][shown]  # noqa: E731
        mean, covariance, force, spread = at("mean"), at("covariance"), at("force"), at("force_covariance")
        behind = stamp - at("at")
        if (behind > 0).any():
            predict(np.maximum(behind, 0) * 1e-9, mean, covariance, spread)
        felt = np.where(at("feels"), at("spread"), np.inf)
        first = robot.skin_at[at("group"), np.argmin(felt, axis=1)] if len(felt) else np.zeros(0, int)
        normal = self._normals()[shown]
        # Where nobody measures more than the normal part, nothing else is said.
        components = np.where(at("feels"), at("components"), 0)
        part = ((components != FORCE_FULL).all(1) & (components == FORCE_NORMAL).any(1))[:, None]
        if part.any():
            along = np.where(part, normal * np.sum(normal * force, axis=1, keepdims=True), force)
            axis = normal[:, :, None] * normal[:, None, :]
            spread = np.where(part[:, :, None], axis @ spread @ axis, spread)
            force = along
        move = robot.link_from_top[first]
        turn, back = move[:, :3, :3], swap(move[:, :3, :3])
        position = apply(turn, mean[:, :3]) + move[:, :3, 3]
        force, normal, spread = apply(turn, force), apply(turn, normal), turn @ spread @ back
        unknown = spread[:, [0, 1, 2], [0, 1, 2]] > KNOWN
        if unknown.any():
            force = np.where(unknown, np.nan, force)
            spread = np.where(unknown[:, :, None] | unknown[:, None, :], np.nan, spread)
        out = {
            "stamp": stamp, "id": at("id"), "link": robot.link[first], "feels": at("feels"),
            "group": at("group"), "called": at("called"), "seen": at("seen"), "born": at("born"), "position": position,
            "normal": normal, "force": force, "components": components.max(1, initial=0),
            "position_covariance": turn @ covariance[:, :3, :3] @ back, "force_covariance": spread,
            "velocity": apply(turn, mean[:, 3:]), "velocity_covariance": turn @ covariance[:, 3:, 3:] @ back,
            "stale": stale, "rate": 1.0 / np.where(self.period > 0, self.period, np.nan),
        }  # fmt: skip
        self._load(out)
        return out

    def _load(self, out):
        """Places contacts in the body frame, and adds wrenches of links, the net wrench and joint torques."""
        robot = self.robot
        world = robot.poses(self.joints.at(out["stamp"]))
        link, position, force, normal = out["link"], out["position"], out["force"], out["normal"]
        turn = world[link, :3, :3]
        out["body_position"] = apply(turn, position) + world[link, :3, 3]
        # The shortest turn from z to the normal (Rodrigues), and about x where the normal is -z.
        z = normal[:, 2]
        safe = np.where(z > -1 + 1e-12, 1 + z, 1.0)
        along = np.zeros((len(link), 3, 3))
        along[:, :2, :2] = np.where((z > -1 + 1e-12)[:, None, None], np.eye(2), np.diag([1.0, -1.0]))
        along[:, :2, :2] -= normal[:, :2, None] * normal[:, None, :2] / safe[:, None, None]
        along[:, :2, 2], along[:, 2, :2], along[:, 2, 2] = normal[:, :2], -normal[:, :2], z
        out["body_quaternion"] = Rotation.from_matrix(turn @ along).as_quat() if len(link) else np.zeros((0, 4))
        links = robot.touched_links
        on = (links[:, None] == link).astype(float)
        out["links"], out["link_force"], out["link_torque"] = links, on @ force, on @ cross(position, force)
        out["link_force_covariance"] = np.tensordot(on, out["force_covariance"], 1)
        turn, origin = world[links, :3, :3], world[links, :3, 3]
        out["body_force"] = apply(turn, out["link_force"])
        out["body_torque"] = apply(turn, out["link_torque"]) + cross(origin, out["body_force"])
        out["net_force"], out["net_torque"] = out["body_force"].sum(0), out["body_torque"].sum(0)
        forces, torques = np.zeros((2, len(robot.links), 3))
        forces[links], torques[links] = out["body_force"], out["body_torque"]
        out["joint_torques"] = robot.torques(world, forces, torques)
