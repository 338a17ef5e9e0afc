//! What happens to tips and crossings once a balance is found: faces held, gone through and left.
//!
//! Entry point: [`Balance::follow_tips`]. Source: Younes 2021, 3.2.2 and 3.2.3.

use super::model::{MAX_NEEDLES, Playback, contains};
use super::source::{What, anchor};
use super::state::{Cut, Tip};
use super::surface::TipLoad;
use super::{Crossing, Curve, Geometry, History, MOST_GROUPS, Slack, Stop, Walked, entry, walk};
use crate::anchors::AnchorPoint;
use crate::step::{Balance, Status};
use nalgebra::{Isometry3, Matrix3, Vector3, Vector6};

/// Where a tip comes from is looked for from this part of the needle behind it \[1\]: it may have come to
/// lie in the face that it left.
const BACK: f64 = 1e-6;
/// Poses that are played back after a puncture.
const PLAYED: usize = 16;

impl Balance<'_> {
    /// Moves tips and histories to the solved tissue; whether rows came or went that change the balance.
    pub(crate) fn follow_tips(&mut self, played: Option<usize>) -> Result<bool, Status> {
        let mut changed = false;
        for needle in 0..self.state.each.len() {
            changed |= self.follow_hold(needle, played)?;
            changed |= self.withdraw(needle);
            changed |= self.draw_end_back(needle)?;
            changed |= self.advance(needle)?;
        }
        Ok(changed)
    }

    /// A tip that holds a face: it may let go, or go through.
    pub(super) fn follow_hold(
        &mut self,
        needle: usize,
        played: Option<usize>,
    ) -> Result<bool, Status> {
        let Tip::Holding { face, rubs, .. } = self.state.each[needle].tip else {
            return Ok(false);
        };
        let Some(TipLoad { load_n: push, .. }) = self.tip_load(needle) else {
            return Ok(false);
        };
        let area = self.sources.needles[needle].needle.tip_area_m2();
        let limit = self.sources.tissue(face.face.cell()).puncture_pa * area;
        if push < 0.0 || (rubs.is_some() && push == 0.0) {
            // Nobody has done work on what was taken only now.
            if !self.work.needles.took[needle] {
                self.release(needle, What::Holding);
            }
            self.work.needles.let_go[needle] = true;
            let state = &mut self.state.each[needle];
            state.log.clear();
            state.tip = if face.enters {
                state.left = Some(face);
                Tip::Outside
            } else {
                Tip::Inside { cut: None }
            };
            return Ok(true);
        }
        let free = played == Some(needle);
        if push > limit || free {
            self.puncture(needle, face, free)?;
            return Ok(true);
        }
        Ok(false)
    }

    /// Crossings that have slid off the tip, and off the end.
    pub(super) fn withdraw(&mut self, needle: usize) -> bool {
        let length = self.sources.needles[needle].needle.shape.length_m();
        let mut changed = false;
        while let Some(last) = self.state.each[needle].history.crossings().last().copied() {
            if last.alpha <= length {
                break;
            }
            let index = self.state.each[needle].holds.len() - 1;
            self.release(needle, What::Crossing(index));
            self.release(needle, What::Cut);
            self.release(needle, What::Holding);
            self.work.needles.let_go[needle] = true;
            let state = &mut self.state.each[needle];
            state.history.pop();
            state.pop_hold();
            // What it held lay beyond this face.
            state.log.clear();
            state.tip = match state.history.tip_cell(&self.sources.mesh) {
                Some(_) => Tip::Inside { cut: None },
                None => Tip::Outside,
            };
            changed = true;
        }
        changed | self.hand_over(needle)
    }

    /// The tip goes on through the cells, or from outside to the boundary.
    pub(super) fn advance(&mut self, needle: usize) -> Result<bool, Status> {
        let curve = self.sources.needles[needle]
            .needle
            .at(&self.state.each[needle].pose);
        match self.state.each[needle].tip {
            Tip::Holding { .. } => Ok(false),
            _ if self.work.needles.let_go[needle] => Ok(false),
            Tip::Inside { .. } => self.advance_inside(needle, &curve),
            Tip::Outside => Ok(self.advance_outside(needle, &curve)),
            Tip::Waiting => {
                if self.is_clear(&curve) {
                    self.state.each[needle].tip = Tip::Outside;
                    self.work.needles.tips[needle] = curve.at(curve.length);
                }
                Ok(false)
            }
        }
    }

    /// Whether no part of a needle, or of another line or arc, is in tissue.
    pub(crate) fn is_clear(&self, curve: &Curve) -> bool {
        let around =
            |cell: &[u32; 4]| contains(&cell.map(|node| self.position(node)), &curve.start);
        self.first_face(curve).is_none() && !self.sources.mesh.cells().iter().any(around)
    }

    /// The tissue where the last solve left it.
    pub(super) fn geometry<'s>(
        &'s self,
        slack: Slack<'s>,
    ) -> Geometry<'s, impl Fn(u32) -> Vector3<f64>> {
        Geometry {
            mesh: &self.sources.mesh,
            hierarchy: &self.sources.hierarchy,
            slack,
            at: |node| self.position(node),
        }
    }

    /// From where `history` has it to the end of a path.
    fn walk_along(&self, path: &Curve, history: &mut History) -> Walked {
        let geometry = self.geometry(Slack::Everywhere(0.0));
        walk(&geometry, path, history, path.length)
    }

    pub(super) fn advance_inside(&mut self, needle: usize, curve: &Curve) -> Result<bool, Status> {
        let mut history = std::mem::take(&mut self.state.each[needle].history);
        let walked = self.walk_along(curve, &mut history);
        let stop = walked.stop;
        let state = &mut self.state.each[needle];
        state.history = history;
        state.tally.guessed += walked.guessed;
        state.hold_new(self.sources.apart_m);
        if state.holds.is_empty() && matches!(stop, Stop::Reached | Stop::Lost) {
            return Ok(self.find_again(needle, curve));
        }
        match stop {
            Stop::Reached => Ok(false),
            Stop::Full => Err(Status::TooManyRows),
            Stop::Lost => {
                state.tally.lost += 1;
                Ok(false)
            }
            Stop::Boundary(face) => {
                self.take(needle, face);
                Ok(true)
            }
        }
    }

    /// A needle that goes through no face, as it is shorter than a cell: its tip is where a straight way
    /// from the middle of the cell that it was in leads. Whether it is out.
    pub(super) fn find_again(&mut self, needle: usize, curve: &Curve) -> bool {
        let mesh = &self.sources.mesh;
        let before = self.state.each[needle].history.tip_cell(mesh);
        let nodes = before.and_then(|cell| mesh.cells().get(cell as usize));
        let Some(nodes) = nodes.copied() else {
            return false;
        };
        let corners = nodes.map(|node| self.position(node));
        let middle = corners.iter().sum::<Vector3<f64>>() / 4.0;
        let Some(path) = Curve::segment(&middle, &curve.at(curve.length)) else {
            return false;
        };
        let mut walked = std::mem::take(&mut self.work.needles.path);
        walked.restart(before, None);
        let stop = self.walk_along(&path, &mut walked).stop;
        let now = walked.tip_cell(mesh);
        self.work.needles.path = walked;
        let out = match stop {
            Stop::Boundary(out) => Some(out),
            _ => None,
        };
        if matches!(stop, Stop::Reached | Stop::Boundary(_)) {
            self.lead_thread_aside(needle, out);
        }
        match stop {
            Stop::Reached => {
                self.state.each[needle].history.restart(now, None);
                false
            }
            Stop::Boundary(_) => {
                self.release(needle, What::Cut);
                let state = &mut self.state.each[needle];
                state.history.clear();
                state.tip = Tip::Outside;
                true
            }
            Stop::Full | Stop::Lost => {
                self.state.each[needle].tally.lost += 1;
                false
            }
        }
    }

    pub(super) fn advance_outside(&mut self, needle: usize, curve: &Curve) -> bool {
        let tip = curve.at(curve.length);
        let back = BACK * curve.length;
        let left = self.state.each[needle].left.take();
        let hit = left
            .and_then(|face| self.above(&face, &tip, back))
            .and_then(|from| self.covers(&from, &tip))
            .or_else(|| {
                let from = self.work.needles.tips[needle] - curve.tangent_at(curve.length) * back;
                self.first_face(&Curve::segment(&from, &tip)?)
            })
            .or_else(|| self.overrun(curve));
        let Some(hit) = hit else {
            return false;
        };
        self.take(needle, hit);
        true
    }

    /// The face under which tissue has come over a tip that was outside, however far that has gone itself: as seen from behind the tip, whence
    /// it would have come.
    fn overrun(&mut self, curve: &Curve) -> Option<Crossing> {
        let tip = curve.at(curve.length);
        let behind = tip - curve.tangent_at(curve.length) * self.sources.edge_m();
        self.covers(&behind, &tip)
    }

    /// A tip that let go of a face without having left the tissue, as it was dragged along it, comes in from
    /// straight above.
    pub(super) fn above(
        &self,
        face: &Crossing,
        tip: &Vector3<f64>,
        by: f64,
    ) -> Option<Vector3<f64>> {
        let (depth, out) = self.depth(face, tip)?;
        (depth > 0.0).then(|| tip + out * (depth + by))
    }

    /// How far a point is inside of a boundary face, where that is now, and the way out; `None` of a face without an area.
    fn depth(&self, face: &Crossing, at: &Vector3<f64>) -> Option<(f64, Vector3<f64>)> {
        let corners = self.sources.mesh.vertices(face.face);
        let [a, b, c] = corners.map(|node| self.position(node));
        let out = (b - a).cross(&(c - a)).try_normalize(0.0)?;
        Some((out.dot(&(a - at)), out))
    }

    /// Whether a point is farther than `by` beyond a boundary face, as seen from where the tip came to it. What was moved since the tip touched
    /// it is met elsewhere on the tip's way.
    fn is_beyond(&self, face: &Crossing, at: &Vector3<f64>, by: f64) -> bool {
        self.depth(face, at)
            .is_none_or(|(depth, _)| by < if face.enters { depth } else { -depth })
    }

    /// Share of their ways to `targets` that needles outside of the tissue may go at once: as far as the boundary, and a piece
    /// farther. Ways up to `free_m` count as free \[m\].
    pub(crate) fn share_to_boundary(&self, targets: &[Isometry3<f64>], free_m: f64) -> f64 {
        let needles = self.state.each.iter().zip(&self.sources.needles);
        let shares = needles.zip(targets).map(|((each, part), target)| {
            let tips = [&each.pose, target].map(|pose| {
                let curve = part.needle.at(pose);
                curve.at(curve.length)
            });
            let way_m = tips[0].metric_distance(&tips[1]);
            if each.tip != Tip::Outside || way_m <= free_m {
                return 1.0;
            }
            let path = Curve::segment(&tips[0], &tips[1]);
            let met = path.and_then(|path| self.first_face(&path));
            met.map_or(1.0, |face| (face.alpha + self.sources.piece_m) / way_m)
        });
        shares.fold(1.0, f64::min)
    }

    /// The boundary face that a point in the tissue is under, seen from a point outside; `None` if there is no
    /// tissue at it.
    pub(super) fn covers(&mut self, from: &Vector3<f64>, at: &Vector3<f64>) -> Option<Crossing> {
        let path = Curve::segment(from, at)?;
        let face = self.first_face(&path)?;
        let mut walked = std::mem::take(&mut self.work.needles.path);
        walked.restart(None, Some(face));
        let stop = self.walk_along(&path, &mut walked).stop;
        self.work.needles.path = walked;
        (stop == Stop::Reached).then_some(face)
    }

    /// The first boundary face that a path from outside goes in through.
    pub(super) fn first_face(&self, path: &Curve) -> Option<Crossing> {
        let mut slack = [0.0; MOST_GROUPS];
        let slack = self.slack(&mut slack);
        entry(
            &self.geometry(Slack::ByGroup(slack)),
            path,
            &self.work.needles.no_history,
            0.0,
            path.length,
        )
        .crossing
    }

    /// The tip comes to hold a boundary face; a free one goes on through it.
    pub(super) fn take(&mut self, needle: usize, face: Crossing) {
        self.release(needle, What::Cut);
        let state = &mut self.state.each[needle];
        state.tip_force = Vector3::zeros();
        self.work.needles.took[needle] = true;
        let id = state.new_id();
        let rubs = None;
        state.tip = Tip::Holding { face, id, rubs };
        let pose = state.pose;
        state.begin_log(pose);
    }

    /// The tip breaks through the face that it holds: the tissue snaps back, and the way since the first
    /// contact is gone once more (3.2.3).
    pub(super) fn puncture(
        &mut self,
        needle: usize,
        face: Crossing,
        free: bool,
    ) -> Result<(), Status> {
        self.release(needle, What::Holding);
        let length = self.sources.needles[needle].needle.shape.length_m();
        let state = &mut self.state.each[needle];
        state.tally.punctures += 1;
        state.tip = if face.enters {
            Tip::Inside { cut: None }
        } else {
            Tip::Outside
        };
        // Without the tip's force; the face itself is not yet held either.
        let mut solves = 0;
        self.settle(&mut solves)?;
        self.unfold();
        self.settle_releases();
        // Tissue has slid far, and what rubs changes now: that slide is over.
        self.book();
        self.follow_surface();
        self.stick();
        let pose = self.state.each[needle].pose;
        let curve = self.sources.needles[needle].needle.at(&pose);
        let point = self.position_of(&anchor(&self.sources.mesh, &face));
        let last = self.state.each[needle].history.crossings().last();
        let least = last.map_or(f64::NEG_INFINITY, |crossing| crossing.alpha);
        let alpha = curve
            .project(&point, length)
            .clamp(least.min(length), length);
        self.take_hold(needle, Crossing { alpha, ..face })?;
        // What lies close behind is met from here.
        self.work.needles.tips[needle] = point;
        if self.sources.settings.playback == Playback::EveryPose && !free {
            self.replay(needle, &face)?;
        } else {
            self.play_back(needle, &face, &point, &curve)?;
        }
        self.state.each[needle].log.clear();
        Ok(())
    }

    /// The way since the tip touched, a balance at each of its poses.
    pub(super) fn replay(&mut self, needle: usize, face: &Crossing) -> Result<(), Status> {
        let mut poses = [Isometry3::identity(); MAX_NEEDLES];
        for (pose, state) in poses.iter_mut().zip(self.state.each.iter()) {
            *pose = state.pose;
        }
        let count = self.state.each.len();
        // What is met on the way begins a log of its own.
        let log = &self.state.each[needle].log;
        let logged = log.len();
        let played = PLAYED.min(logged.max(1));
        let mut way = [poses[needle]; PLAYED];
        for (index, pose) in (1..played).zip(&mut way) {
            *pose = *log.get(index * logged / played).unwrap_or(pose);
        }
        let part = &self.sources.needles[needle].needle;
        let length = part.shape.length_m();
        let is_before = |pose: &&Isometry3<f64>| {
            !self.is_beyond(face, &part.at(pose).at(length), BACK * length)
        };
        // The last one is where the needle is.
        let before = way[..played - 1].iter().take_while(is_before).count();
        for pose in &way[before..played] {
            poses[needle] = *pose;
            // Nobody's hand does this work.
            let from = self.state.each[needle].pose;
            let centre = from.translation.vector;
            let before = self.wrench_on(needle, &centre);
            self.round_by_round(&poses[..count], Some(needle))?;
            let curve = self.sources.needles[needle].needle.at(&poses[needle]);
            self.work.needles.tips[needle] = curve.at(curve.length);
            let way = poses[needle].translation.vector - centre;
            let turn = (poses[needle].rotation * from.rotation.inverse()).scaled_axis();
            let after = self.wrench_on(needle, &poses[needle].translation.vector);
            let twist = Vector6::new(way.x, way.y, way.z, turn.x, turn.y, turn.z);
            self.state.each[needle].tally.release_j += 0.5 * (before + after).dot(&twist);
        }
        Ok(())
    }

    /// The tip's way since it touched, through the tissue as it is now.
    pub(super) fn play_back(
        &mut self,
        needle: usize,
        face: &Crossing,
        from: &Vector3<f64>,
        curve: &Curve,
    ) -> Result<(), Status> {
        let part = &self.sources.needles[needle].needle;
        let mut first = Some(*face);
        let length = curve.length;
        let logged = self.state.each[needle].log.len();
        let mut here = *from;
        let tip = curve.at(length);
        let forward = curve.tangent_at(length);
        for index in 1..=PLAYED.min(logged.max(1)) {
            let played = PLAYED.min(logged.max(1));
            let next = if index == played {
                tip
            } else {
                let pose = &self.state.each[needle].log[(index * logged / played).min(logged - 1)];
                let then = part.at(pose);
                then.at(length)
            };
            // The tip cuts where it comes for the first time.
            if (next - here).dot(&forward) <= 0.0 && index < played {
                continue;
            }
            if first.is_some() && !self.is_beyond(face, &next, BACK * length) {
                continue;
            }
            let Some(path) = Curve::segment(&here, &next) else {
                continue;
            };
            let inside = self.state.each[needle].history.tip_cell(&self.sources.mesh);
            if inside.is_none() {
                // Out on the other side: what lies beyond is met like anything else.
                break;
            }
            let mut walked = std::mem::take(&mut self.work.needles.path);
            match first.take() {
                Some(face) => walked.restart(face.from(), Some(Crossing { alpha: 0.0, ..face })),
                None => walked.restart(inside, None),
            }
            let known = walked.crossings().len();
            let stop = self.walk_along(&path, &mut walked).stop;
            self.work.needles.path = walked;
            let out = match stop {
                Stop::Boundary(face) => Some(face),
                Stop::Full => return Err(Status::TooManyRows),
                Stop::Lost => {
                    self.state.each[needle].tally.lost += 1;
                    None
                }
                Stop::Reached => None,
            };
            self.hold_found(needle, known, out, curve)?;
            if let Some(out) = out {
                let state = &mut self.state.each[needle];
                state.tip = Tip::Outside;
                state.tally.punctures += 1;
                self.work.needles.tips[needle] =
                    self.position_of(&anchor(&self.sources.mesh, &out));
                break;
            }
            here = next;
        }
        Ok(())
    }

    /// The needle takes hold of what its tip's path has found beyond the first `known`, and of where it came out.
    fn hold_found(
        &mut self,
        needle: usize,
        known: usize,
        out: Option<Crossing>,
        curve: &Curve,
    ) -> Result<(), Status> {
        let length = curve.length;
        let found = self.work.needles.path.crossings().len();
        for index in known..found + usize::from(out.is_some()) {
            let crossing = match out {
                Some(out) if index == found => out,
                _ => self.work.needles.path.crossings()[index],
            };
            let point = self.position_of(&anchor(&self.sources.mesh, &crossing));
            let last = self.state.each[needle].history.crossings().last();
            let least = last.map_or(0.0, |last| last.alpha);
            let alpha = curve
                .project(&point, length)
                .clamp(least.min(length), length);
            self.take_hold(needle, Crossing { alpha, ..crossing })?;
        }
        Ok(())
    }

    /// Brings the end of the cut to where the tip is now, if it went further.
    pub(super) fn cut(&mut self, needle: usize) {
        let Tip::Inside { cut } = self.state.each[needle].tip else {
            return;
        };
        let Some(cell) = self.state.each[needle].history.tip_cell(&self.sources.mesh) else {
            return;
        };
        let part = &self.sources.needles[needle].needle;
        let limit_n = self.sources.tissue(cell).cutting_pa * part.tip_area_m2();
        if limit_n == 0.0 {
            self.state.each[needle].tip = Tip::Inside { cut: None };
            return;
        }
        if cut.is_some_and(|cut| cut.cell == cell && !cut.cuts) {
            return;
        }
        let curve = part.at(&self.state.each[needle].pose);
        let Some(nodes) = self.sources.mesh.cells().get(cell as usize).copied() else {
            return;
        };
        let corners = nodes.map(|node| self.position(node));
        let weights = barycentric(&corners, &curve.at(curve.length));
        self.state.each[needle].tip = Tip::Inside {
            cut: Some(Cut {
                at: AnchorPoint { nodes, weights },
                cell,
                limit_n,
                pressed: true,
                axial_n: cut.map_or(0.0, |cut| cut.axial_n),
                cuts: cut.is_some_and(|cut| cut.cuts),
            }),
        };
    }
}

/// Weights of a point in a cell, none below zero, with sum 1; all alike in a flat cell.
fn barycentric(corners: &[Vector3<f64>; 4], at: &Vector3<f64>) -> [f64; 4] {
    let [a, b, c, d] = corners;
    let edges = Matrix3::from_columns(&[b - a, c - a, d - a]);
    let Some(inverse) = edges.try_inverse() else {
        return [0.25; 4];
    };
    let inner = inverse * (at - a);
    let weights = [1.0 - inner.sum(), inner.x, inner.y, inner.z].map(|w| w.clamp(0.0, 1.0));
    let sum: f64 = weights.iter().sum();
    if sum > 0.0 && sum.is_finite() {
        weights.map(|weight| weight / sum)
    } else {
        [0.25; 4]
    }
}
