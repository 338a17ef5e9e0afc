//! A needle between two frames of the host: it sticks, slides and punctures by itself.
//!
//! Entry points: [`LocalNeedle::adopt`] when a frame comes, [`LocalNeedle::correction`] every tick. The force along
//! the slide is elastic-plastic (return mapping, Simo and Hughes 1998, 1.4): its trial sticks, its bounds are the
//! frame's courses, forward from below and backward from above. Where a course jumps a boundary gives way, which
//! it does once. What the grip has done since the frame's console time is gone through again with the new
//! frame, so that slips and punctures that the host did not know of are had again.

use super::rows::symmetric_times;
use crate::math::{Vec3, clamp, max, min};
use crate::wire::ValidNeedle;
use crate::wire::message::{COURSE_POINTS, Needle};
use crate::wire::validate::{MAX_POSITION, MAX_TANGENT, MAX_WRENCH};

/// Places of the grip that are kept.
const PAST: usize = 64;
/// Time between two of them \[us\]: all of them reach back over 126 ms, further than a force is late.
const PAST_US: u32 = 2_000;
/// Curvature below which a needle is a line \[1/m\]: a circle of 1 km.
const STRAIGHT: f32 = 1e-3;
/// Part of a slide along the old frame's direction that is one along the new one's, at least \[1\].
const SAME_WAY: f32 = 0.9;
/// Part of its stiffness that a needle must have where it sticks for its tangent to say how it lets go \[1\].
const HOLDS: f32 = 0.05;
/// Most of a force and of a moment that come with an axial force of 1 \[1 or m\].
const MAX_GIVES: f32 = 4.0;
/// Stiffness below which nothing holds a needle \[N/m\].
const SOFTEST: f32 = 1e-3;
/// Stiffness of a needle that sticks stiffly, in what the device renders stably \[1\].
const STIFF: f32 = 0.5;
/// Ways shorter than this have no slope of their own \[m\].
const SHORT_M: f32 = 1e-6;

/// Axial force against way, one way: straight between its points, the first of which is the frame's own.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Curve {
    way_m: [f32; COURSE_POINTS + 1],
    axial_n: [f32; COURSE_POINTS + 1],
}

impl Curve {
    fn new(axial_n: f32, points: impl Iterator<Item = [f32; 2]>) -> Self {
        let mut curve = Curve {
            way_m: [0.0; COURSE_POINTS + 1],
            axial_n: [axial_n; COURSE_POINTS + 1],
        };
        let (mut last, mut points) = ([0.0, axial_n], points);
        let places = curve.way_m.iter_mut().zip(&mut curve.axial_n);
        for (way_m, axial_n) in places.skip(1) {
            last = points.next().unwrap_or(last);
            [*way_m, *axial_n] = last;
        }
        curve
    }

    /// Straight on to `end`, then level.
    fn ramp(axial_n: f32, end: [f32; 2]) -> Self {
        Curve::new(axial_n, [end].into_iter())
    }

    fn legs(&self) -> impl Iterator<Item = [[f32; 2]; 2]> + '_ {
        let starts = self.way_m.iter().zip(&self.axial_n);
        let ends = self.way_m.iter().zip(&self.axial_n).skip(1);
        starts
            .zip(ends)
            .map(|((from, before), (to, after))| [[*from, *before], [*to, *after]])
    }

    /// The force after a way that is not negative; at a jump the one before it, beyond the end the last.
    fn at(&self, way_m: f32) -> f32 {
        let [.., last] = self.axial_n;
        let (mut force, mut found) = (last, false);
        for [[from, before], [to, after]] in self.legs() {
            if !found && way_m <= to {
                let part = if to > from {
                    (way_m - from) / (to - from)
                } else {
                    0.0
                };
                force = before + (after - before) * clamp(part, 0.0, 1.0);
                found = true;
            }
        }
        force
    }

    /// The steepest change of force, up or down, on the first `legs` of it \[N/m\].
    fn steepest(&self, sign: f32, legs: usize) -> f32 {
        self.legs()
            .take(legs)
            .fold(0.0, |most, [[from, before], [to, after]]| {
                let way = to - from;
                if way > SHORT_M {
                    max(most, sign * (after - before) / way)
                } else {
                    most
                }
            })
    }

    /// How much force is lost per way that the needle slides, up to what holds it next, before the first jump and behind it
    /// \[N/m\], (2): by friction on what goes in. What is steeper than half of `stick_n_per_m` sticks.
    fn grows(&self, stick_n_per_m: f32) -> [f32; 2] {
        let (mut way_m, mut lost_n) = ([0.0; 2], [0.0; 2]);
        let (mut side, mut ended) = (0, false);
        for [[from, before], [to, after]] in self.legs() {
            let (way, lost) = (to - from, before - after);
            if way <= 0.0 && lost < 0.0 {
                if side == 1 {
                    break;
                }
                (side, ended) = (1, false);
            } else if lost > 0.5 * stick_n_per_m * way {
                ended |= way_m.get(side).is_some_and(|way_m| *way_m > 0.0);
            } else if let (false, Some(way_m), Some(lost_n)) =
                (ended, way_m.get_mut(side), lost_n.get_mut(side))
            {
                (*way_m, *lost_n) = (*way_m + way, *lost_n + lost);
            }
        }
        core::array::from_fn(|side| {
            let (way_m, lost_n) = (way_m[side], lost_n[side]);
            let slope = if way_m > SHORT_M { lost_n / way_m } else { 0.0 };
            let slope = clamp(slope, 0.0, 0.5 * stick_n_per_m);
            // Of a way of the grip less slides: what holds goes along as friction grows.
            slope / (1.0 - slope / max(stick_n_per_m, SOFTEST))
        })
    }

    /// The least force from a way on, up to the first jump behind it.
    fn least(&self, from_m: f32, gone: bool) -> f32 {
        let mut least = f32::MAX;
        for [[at, before], [to, after]] in self.legs() {
            let jumps = to == at && after > before;
            if jumps && !gone {
                least = min(least, before);
                break;
            }
            if to >= from_m {
                least = min(least, min(before, after));
            }
        }
        least
    }

    /// The largest force.
    fn most(&self) -> f32 {
        self.axial_n.iter().copied().fold(f32::MIN, max)
    }

    /// The first jump: where, and the forces before and after it.
    fn jump(&self) -> Option<[f32; 3]> {
        let is_jump = |[[from, before], [to, after]]: &[[f32; 2]; 2]| to == from && after > before;
        let jump = self.legs().find(is_jump);
        jump.map(|[[_, before], [at, after]]| [at, before, after])
    }
}

/// A place of the grip along the slide, and when it was there.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Place {
    /// Lower half of the console time \[us\].
    time_us: u32,
    /// From the frame's pose \[m\].
    slide_m: f32,
}

/// The needle in the grip, as one frame has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalNeedle {
    needle: u8,
    solved_us: u64,
    /// Motion of the grip per metre of slide, as in the frame.
    slide: [f32; 6],
    /// What a motion of the grip makes of slide, and an axial force of wrench: `across . slide` = 1.
    across: [f32; 6],
    /// Wrench that comes with an axial force of 1 as the needle slips: the rest of what holds it gives way, too.
    gives: [f32; 6],
    /// Axial force at the frame's pose \[N\], and what the frame's tangent takes from it per metre \[N/m\].
    solved_n: f32,
    now_n_per_m: f32,
    /// Of a needle that sticks, on the way forward, where no course is steeper, and backward, as what holds it unloads
    /// \[N/m\], (2).
    stick_n_per_m: [f32; 2],
    /// Whether it sticks as stiffly as the device can hardly render.
    is_stiff: bool,
    forward: Curve,
    backward: Curve,
    /// Where a boundary gives way on the way forward \[m\], the force right after, and the largest that pulls the needle on
    /// then \[N\], besides friction on what has gone in since.
    jump_m: f32,
    after_n: f32,
    most_n: f32,
    /// Friction on what goes in, before it gives way and after that \[N/m\], (2).
    grows_n_per_m: [f32; 2],
    /// How far tissue springs back over the needle then \[m\], and what had slid forward before \[m\].
    springs_m: f32,
    from_m: f32,
    /// Where the grip was last \[m\], and the axial force there \[N\].
    at_m: f32,
    axial_n: f32,
    /// Slid forward and backward since the frame's pose \[m\], magnitudes.
    slid_m: [f32; 2],
    /// Console time at which the boundary gave way \[us\].
    punctured_us: Option<u64>,
    past: [Place; PAST],
    /// Of those, how many there are, and which comes next.
    known: usize,
    next: usize,
}

impl LocalNeedle {
    /// The needle of a frame, at the frame's pose.
    pub fn new(frame: &ValidNeedle) -> Self {
        let body = frame.body();
        let (forward, backward) = (forward(body), backward(body));
        let [stiffest, back] = [(forward, -1.0), (backward, 1.0)]
            .map(|(curve, sign)| curve.steepest(sign, COURSE_POINTS));
        let [all, now] = body.stiffness_n_per_m;
        let stick_n_per_m = min(max(all, max(stiffest, back)), MAX_TANGENT);
        // Of a needle that is apart: by what holds it first.
        let held = forward.legs().take_while(|[[from, _], [to, _]]| to > from);
        let held_n_per_m = forward.steepest(-1.0, held.count());
        let unloads = [all, held_n_per_m].into_iter().find(|k| *k > 0.0);
        let unloads = max(unloads.unwrap_or(stick_n_per_m), back);
        let back_n_per_m = min(unloads, stick_n_per_m);
        let [_, most_n] = body.friction_n;
        let jump = forward.jump();
        let [jump_m, before_n, after_n] =
            jump.unwrap_or([f32::MAX, body.punctured_n, body.punctured_n]);
        let mut needle = LocalNeedle {
            needle: body.needle,
            solved_us: frame.console_time_us(),
            slide: body.slide,
            across: across(&body.slide),
            gives: across(&body.slide),
            solved_n: body.axial_n,
            now_n_per_m: now,
            stick_n_per_m: [stick_n_per_m, back_n_per_m],
            is_stiff: false,
            forward,
            backward,
            jump_m,
            after_n,
            most_n: max(most_n, after_n),
            grows_n_per_m: forward.grows(back_n_per_m),
            springs_m: ramp_m(after_n - before_n, back_n_per_m),
            from_m: 0.0,
            at_m: 0.0,
            axial_n: body.axial_n,
            slid_m: [0.0; 2],
            punctured_us: None,
            past: [Place::default(); PAST],
            known: 0,
            next: 0,
        };
        needle.keep(Place {
            time_us: frame.console_time_us() as u32,
            slide_m: 0.0,
        });
        needle
    }

    /// Limits the stiffness with which it sticks \[N/m\], of a frame whose tangent has been limited from `told` to `tangent`, packed (21).
    pub fn limit(&mut self, most_n_per_m: f32, [told, tangent]: [&[f32; 21]; 2]) {
        let along = |packed| {
            let yields = symmetric_times(packed, &self.slide);
            yields
                .iter()
                .zip(&self.slide)
                .map(|(w, s)| w * s)
                .sum::<f32>()
        };
        let (before, after) = (along(told), along(tangent));
        if before < 0.0 && after < 0.0 && before != after {
            self.now_n_per_m *= after / before;
        }
        let stiff_n_per_m = STIFF * most_n_per_m;
        self.is_stiff = self.stick_n_per_m.iter().any(|k| *k > stiff_n_per_m);
        self.stick_n_per_m = self.stick_n_per_m.map(|stick| min(stick, most_n_per_m));
    }

    /// Stiffness with which it sticks on the way forward, as far as it is rendered \[N/m\].
    pub fn stick_n_per_m(&self) -> f32 {
        let [forward, _] = self.stick_n_per_m;
        forward
    }

    /// Stiffness along the slide with which it sticks, and which the frame's tangent has not \[N/m\]: of one that slips.
    pub(super) fn lacking_n_per_m(&self) -> f32 {
        let [forward, backward] = self.stick_n_per_m;
        max(max(forward, backward) - max(self.now_n_per_m, 0.0), 0.0)
    }

    /// Whether it sticks as stiffly as the device can hardly render.
    pub fn is_stiff(&self) -> bool {
        self.is_stiff
    }

    /// Bound of a needle whose slide does not turn: direction of the slide, and the axial force if
    /// the grip goes on to `dx` with the least and the largest that hold the needle there \[N\].
    pub fn bounds(&self, dx: &[f32; 6]) -> Option<(Vec3, f32, [f32; 2])> {
        let [x, y, z, a, b, c] = self.slide;
        let slide_m = self.slide_of(dx)?;
        if a * a + b * b + c * c > STRAIGHT * STRAIGHT {
            return None;
        }
        let (axial_n, gone) = self.next(slide_m);
        let least_n = self
            .forward
            .least(if gone { self.jump_m } else { 0.0 }, gone);
        let most_n = if gone {
            self.high(slide_m, 0.0, true)
        } else {
            max(self.backward.most(), self.high(slide_m, 0.0, false))
        };
        Some((
            Vec3::new(x, y, z),
            axial_n,
            [min(least_n, axial_n), max(most_n, axial_n)],
        ))
    }

    /// What goes in does not rub: for measuring what that is worth.
    pub(super) fn forget_friction(&mut self) {
        self.grows_n_per_m = [0.0; 2];
    }

    /// Takes note of the frame's tangent, packed (21), and wrench: a needle that slips by s has the wrench of one that was moved
    /// that much less, `-s T slide`, of which the axial force is a part only. The tangent turns what rubs on a round needle with
    /// it, but where it slips its course through the tissue stays.
    pub fn note_contact(&mut self, tangent: &[f32; 21], wrench: &[f32; 6]) {
        let yields = symmetric_times(tangent, &self.slide);
        let axial: f32 = yields.iter().zip(&self.slide).map(|(w, s)| w * s).sum();
        // Of a needle that slides all along there is nothing to be had from its tangent.
        let [stick_n_per_m, _] = self.stick_n_per_m;
        if axial < -HOLDS * stick_n_per_m && axial.is_finite() {
            let [.., a, b, c] = self.slide;
            let [x, y, z, u, v, w] = *wrench;
            let turn = Vec3::new(a, b, c);
            let (force, moment) = (
                turn.cross(&Vec3::new(x, y, z)),
                turn.cross(&Vec3::new(u, v, w)),
            );
            let turned = force.iter().chain(&moment);
            let mut gives = yields;
            for (part, turned) in gives.iter_mut().zip(turned) {
                *part = (*part - turned) / axial;
            }
            let [x, y, z, a, b, c] = gives.map(|part| part * part);
            if max(x + y + z, a + b + c) <= MAX_GIVES * MAX_GIVES {
                self.gives = gives;
            }
        }
    }

    /// Console time of the state that was solved for \[us\].
    pub fn solved_us(&self) -> u64 {
        self.solved_us
    }

    /// Axial force on the tool \[N\] where the grip was last.
    pub fn axial_n(&self) -> f32 {
        self.axial_n
    }

    /// Console time at which a boundary gave way that the host did not know of \[us\].
    pub fn punctured_us(&self) -> Option<u64> {
        self.punctured_us
    }

    /// Takes the place of `old`: goes once more through what the grip has done since this frame's console
    /// time. What has been punctured since then stays so, until the host says what is.
    pub fn adopt(&mut self, old: &LocalNeedle) {
        let along: f32 = self.across.iter().zip(&old.slide).map(|(a, b)| a * b).sum();
        let same = old.needle == self.needle && (along - 1.0).abs() <= 1.0 - SAME_WAY;
        if !same || self.solved_us < old.solved_us {
            return;
        }
        let from = self.solved_us as u32;
        let start_m = old.slide_at(from);
        let had_us = old.punctured_us.filter(|at| *at > self.solved_us);
        for place in old.places() {
            // Times wrap around; what is kept is far less than half of that.
            let since = place.time_us.wrapping_sub(from) as i32;
            if since <= 0 {
                continue;
            }
            let slide_m = place.slide_m - start_m;
            let now_us = self.solved_us.wrapping_add(u64::from(since.unsigned_abs()));
            if had_us.is_some_and(|at| at <= now_us) {
                self.give_way(had_us);
            }
            self.go(slide_m, now_us);
            self.keep(Place { slide_m, ..*place });
        }
        if had_us.is_some() {
            self.give_way(had_us);
        }
    }

    /// [`follow`](Self::follow), then [`lacking`](Self::lacking) there.
    pub fn correction(&mut self, dx: &[f32; 6], now_us: u64) -> [f32; 6] {
        self.follow(dx, now_us);
        self.lacking(dx)
    }

    /// The grip has moved by `dx` from the frame's pose \[m, rad\], (6), at `now_us`: what sticks goes along, what is at
    /// its bound slides, and a boundary may give way.
    pub fn follow(&mut self, dx: &[f32; 6], now_us: u64) {
        if let Some(slide_m) = self.slide_of(dx) {
            self.note(slide_m, now_us);
            self.go(slide_m, now_us);
        }
    }

    /// What the wrench that is linear in the grip's motion lacks, (6) \[N, N m\], if the grip goes on to `dx`, where it
    /// need not get.
    pub fn lacking(&self, dx: &[f32; 6]) -> [f32; 6] {
        let Some(slide_m) = self.slide_of(dx) else {
            return [0.0; 6];
        };
        let linear_n = self.solved_n - self.now_n_per_m * slide_m;
        let (axial_n, _) = self.next(slide_m);
        let lacking_n = axial_n - linear_n;
        self.gives.map(|part| part * lacking_n)
    }

    /// Whether the boundary has given way if the grip goes on to `dx`.
    pub fn is_through(&self, dx: &[f32; 6]) -> bool {
        let gives_way = |slide_m| self.next(slide_m).1;
        self.slide_of(dx).is_some_and(gives_way)
    }

    /// Way along the slide of a motion of the grip \[m\].
    fn slide_of(&self, dx: &[f32; 6]) -> Option<f32> {
        let slide_m: f32 = self.across.iter().zip(dx).map(|(a, b)| a * b).sum();
        let most_m = 2.0 * MAX_POSITION;
        slide_m.is_finite().then(|| clamp(slide_m, -most_m, most_m))
    }

    /// The return mapping, from where the grip was last.
    fn go(&mut self, slide_m: f32, now_us: u64) {
        let stick_n_per_m = self.sticks(slide_m);
        let trial = self.axial_n - stick_n_per_m * (slide_m - self.at_m);
        let (axial_n, gives_way) = self.next(slide_m);
        if gives_way && self.punctured_us.is_none() {
            self.punctured_us = Some(now_us);
            self.from_m = self.slid_forward();
        }
        self.at_m = slide_m;
        self.axial_n = axial_n;
        let [forward_m, backward_m] = self.slid_m;
        if stick_n_per_m > 0.0 {
            let slip = clamp(
                (self.axial_n - trial) / stick_n_per_m,
                -MAX_POSITION,
                MAX_POSITION,
            );
            let most = 2.0 * MAX_POSITION;
            self.slid_m = [
                min(forward_m + max(slip, 0.0), most),
                min(backward_m + max(-slip, 0.0), most),
            ];
        }
    }

    /// How stiff it is while it sticks on the way to a slide \[N/m\].
    fn sticks(&self, slide_m: f32) -> f32 {
        let [forward, backward] = self.stick_n_per_m;
        if slide_m < self.at_m {
            backward
        } else {
            forward
        }
    }

    /// Slid forward since the frame's pose, less what slid backward \[m\].
    fn slid_forward(&self) -> f32 {
        let [forward_m, backward_m] = self.slid_m;
        forward_m - backward_m
    }

    /// The axial force if the grip goes on to `slide_m`, and whether the boundary has given way there.
    fn next(&self, slide_m: f32) -> (f32, bool) {
        let [_, backward_m] = self.slid_m;
        let (was, before_m) = (self.axial_n, self.at_m);
        let mut gone = self.punctured_us.is_some();
        // Asked again at one place it says the same again.
        if slide_m == before_m {
            return (was, gone);
        }
        let trial = was - self.sticks(slide_m) * (slide_m - before_m);
        // A bound holds against motion towards it. What is not at it yet is not lifted to it, but moves as it does.
        let next = if slide_m > before_m {
            let old = self.low(before_m + backward_m, gone);
            let ahead = slide_m + backward_m;
            gone |= ahead > self.jump_m;
            let low = self.low(ahead, gone);
            max(trial, min(low, was + max(low - old, 0.0)))
        } else {
            let old = self.high(before_m, 0.0, gone);
            let high = self.high(slide_m, before_m - slide_m, gone);
            min(trial, max(high, was - max(old - high, 0.0)))
        };
        (clamp(next, -MAX_WRENCH, MAX_WRENCH), gone)
    }

    /// The least force on the way forward; without a bound where the frame's way has not begun.
    fn low(&self, ahead_m: f32, gone: bool) -> f32 {
        if gone && ahead_m <= self.jump_m {
            self.after_n
        } else if gone || ahead_m > 0.0 {
            self.forward.at(ahead_m)
        } else {
            -MAX_WRENCH
        }
    }

    /// The largest force on the way backward at a slide, if so much more slides back by then: friction holds what has gone in
    /// since the frame's pose, or since the boundary has given way.
    fn high(&self, slide_m: f32, back_m: f32, gone: bool) -> f32 {
        let [before, after] = self.grows_n_per_m;
        let [_, sticks] = self.stick_n_per_m;
        // What lets go of friction lets go of tissue that it held: more slides than the grip goes.
        let grows = if gone { after } else { before };
        let lets_go = clamp(1.0 - grows / max(sticks, SOFTEST), 0.5, 1.0);
        let gone_in_m = self.slid_forward() - back_m / lets_go;
        if gone {
            self.most_n + grows * max(gone_in_m - self.from_m, 0.0)
        } else if gone_in_m > 0.0 {
            self.backward.most() + grows * gone_in_m
        } else if slide_m < 0.0 {
            self.backward.at(-slide_m)
        } else {
            MAX_WRENCH
        }
    }

    /// The boundary has given way, wherever the frame has it.
    fn give_way(&mut self, when_us: Option<u64>) {
        if self.punctured_us.is_none() {
            self.punctured_us = when_us;
            self.axial_n = self.after_n;
            self.from_m = self.slid_forward() - self.springs_m;
        }
    }

    /// Keeps where the grip is, every so often.
    fn note(&mut self, slide_m: f32, now_us: u64) {
        let time_us = now_us as u32;
        let newest = self.past.get((self.next + PAST - 1) % PAST);
        let newest = newest.filter(|_| self.known > 0);
        let due = newest.is_none_or(|last| time_us.wrapping_sub(last.time_us) >= PAST_US);
        if due {
            self.keep(Place { time_us, slide_m });
        }
    }

    fn keep(&mut self, place: Place) {
        if let Some(slot) = self.past.get_mut(self.next) {
            *slot = place;
        }
        self.next = (self.next + 1) % PAST;
        self.known = (self.known + 1).min(PAST);
    }

    /// What is kept, the oldest first.
    fn places(&self) -> impl Iterator<Item = &Place> {
        let (newer, older) = self.past.split_at_checked(self.next).unwrap_or_default();
        let older = older.iter().take(self.known.saturating_sub(self.next));
        older.chain(newer.iter().skip(self.next.saturating_sub(self.known)))
    }

    /// Where the grip was at a time, between what is kept.
    fn slide_at(&self, time_us: u32) -> f32 {
        let mut before: Option<&Place> = None;
        for place in self.places() {
            let left = place.time_us.wrapping_sub(time_us) as i32;
            if left < 0 {
                before = Some(place);
                continue;
            }
            let Some(before) = before else {
                return place.slide_m;
            };
            let apart = place.time_us.wrapping_sub(before.time_us) as f32;
            let part = if apart > 0.0 {
                left as f32 / apart
            } else {
                0.0
            };
            return place.slide_m - (place.slide_m - before.slide_m) * part;
        }
        before.map_or(self.at_m, |before| before.slide_m)
    }
}

/// The axial force on the way forward; by friction, stiffness and threshold where the host has not looked.
fn forward(body: &Needle) -> Curve {
    let [known, _] = body.course.ways();
    if !known.is_empty() {
        return Curve::new(body.axial_n, known.iter().copied());
    }
    let [all, now] = body.stiffness_n_per_m;
    let [most_n, _] = body.friction_n;
    if body.puncture_n > 0.0 && now > 0.0 {
        let way = min(max(body.puncture_n - body.hold_n, 0.0) / now, MAX_POSITION);
        let there = body.axial_n - now * way;
        let points = [[way, there], [way, max(there, body.punctured_n)]];
        return Curve::new(body.axial_n, points.into_iter());
    }
    let left_n = max(body.axial_n + most_n, 0.0);
    // One that slides back sticks as it turns.
    let sticks = if now > 0.0 { now } else { all };
    let end = [ramp_m(left_n, sticks), body.axial_n - left_n];
    Curve::ramp(body.axial_n, end)
}

/// As [`forward`], on the way backward.
fn backward(body: &Needle) -> Curve {
    let [_, known] = body.course.ways();
    if !known.is_empty() {
        return Curve::new(body.axial_n, known.iter().copied());
    }
    let [all, now] = body.stiffness_n_per_m;
    let [_, most_n] = body.friction_n;
    let left_n = max(most_n - body.axial_n, 0.0);
    Curve::ramp(
        body.axial_n,
        [ramp_m(left_n, max(all, now)), body.axial_n + left_n],
    )
}

/// The way on which a force changes by so much.
fn ramp_m(change_n: f32, stiffness_n_per_m: f32) -> f32 {
    if stiffness_n_per_m > 0.0 {
        min(change_n / stiffness_n_per_m, MAX_POSITION)
    } else {
        MAX_POSITION
    }
}

/// The twist `a` with `a . slide` = 1 that is along the slide, turns weighed by the needle's radius; zero where the
/// grip hardly moves when the needle slides.
fn across(slide: &[f32; 6]) -> [f32; 6] {
    let [x, y, z, a, b, c] = *slide;
    let linear = x * x + y * y + z * z;
    let turn = a * a + b * b + c * c;
    let (weight, square) = if turn > STRAIGHT * STRAIGHT {
        (1.0 / turn, linear + 1.0)
    } else {
        (0.0, linear)
    };
    if square < 0.25 {
        return [0.0; 6];
    }
    let (shift, weight) = (1.0 / square, weight / square);
    [
        x * shift,
        y * shift,
        z * shift,
        a * weight,
        b * weight,
        c * weight,
    ]
}
