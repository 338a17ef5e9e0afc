//! What happens at a needle's end: faces that it goes through become its thread's, and come back as it is drawn back.
//!
//! Entry points: [`Balance::hand_over`], [`Balance::draw_end_back`]. Source: Younes 2021, algorithm 3.4, lines 19 to 27. A needle goes
//! back by its thread's way, face by face, wherever tissue has gone meanwhile; one whose way nobody has kept finds its own,
//! as a tip does. An end is blunt and breaks through nothing: into tissue it goes back by the hole that its thread goes through.

use super::source::{Release, What, anchor};
use super::state::Tip;
use super::{Crossing, Curve, Slack, Stop, walk_back};
use crate::step::{Balance, Status};

impl Balance<'_> {
    /// Crossings that have slid off the end: whether there are any.
    pub(super) fn hand_over(&mut self, needle: usize) -> bool {
        let crossings = self.state.each[needle].history.crossings();
        let behind = crossings
            .iter()
            .take_while(|first| first.alpha < 0.0)
            .count();
        if behind == 0 {
            return false;
        }
        for index in 0..behind {
            self.release(needle, What::Crossing(index));
            // The thread follows.
            let crossing = self.state.each[needle].history.crossings()[index];
            self.lead_thread(needle, crossing);
        }
        let state = &mut self.state.each[needle];
        state.history.drop_behind(&self.sources.mesh, 0.0);
        state.drop_holds(behind);
        self.count_anew(needle, |taken| taken.checked_sub(behind));
        self.work.needles.gave[needle] = true;
        true
    }

    /// The thread of a needle, if it has one, goes through a face that the needle's end has gone through.
    fn lead_thread(&mut self, needle: usize, crossing: Crossing) {
        let Some(index) = self.sources.threads.of_needle(needle) else {
            return;
        };
        let apart = self.apart(index, &crossing);
        if let Some(thread) = self.state.threads.get_mut(index) {
            let has_room = thread.pass(&self.sources.mesh, crossing, apart);
            self.state.each[needle].tally.lost += u32::from(!has_room);
        }
    }

    /// The end of a needle that goes through no face has come out of its cell by the way in [`super::source::NeedleWork::path`], and
    /// through `out` if it left the tissue: so does its thread, or it comes back by what it has gone through.
    pub(super) fn lead_thread_aside(&mut self, needle: usize, out: Option<Crossing>) {
        let mesh = &self.sources.mesh;
        let before = self.state.each[needle].history.before();
        let chained = self.chained(needle);
        if chained.is_none_or(|(_, last)| last.to(mesh) != before) {
            return;
        }
        let found = self.work.needles.path.crossings().len();
        for place in 0..=found {
            let way = self.work.needles.path.crossings().get(place).copied();
            let Some(crossing) = way.or(out) else {
                return;
            };
            let back = self.chained(needle).filter(|(_, last)| {
                last.to(mesh) == crossing.from() && last.from() == crossing.to(mesh)
            });
            match back {
                Some((thread, _)) => self.state.threads[thread].drop_last(),
                None => self.lead_thread(
                    needle,
                    Crossing {
                        alpha: 0.0,
                        ..crossing
                    },
                ),
            }
        }
    }

    /// A needle's thread, and the last face that it goes through, if that lies between the needle and what holds the thread.
    fn chained(&self, needle: usize) -> Option<(usize, Crossing)> {
        let index = self.sources.threads.of_needle(needle)?;
        let thread = self.state.threads.get(index)?;
        Some((index, thread.passed.last()?.crossing))
    }

    /// An end that goes back takes what it comes to: whether there are new crossings.
    ///
    /// # Errors
    /// No room for one.
    pub(super) fn draw_end_back(&mut self, needle: usize) -> Result<bool, Status> {
        let curve = self.curve(needle);
        let way = curve.start - self.work.needles.ends[needle];
        let goes_back = way.dot(&curve.tangent) < 0.0;
        // What it gave in this balance would be given to and fro.
        if !goes_back
            || self.work.needles.gave[needle]
            || self.state.each[needle].tip == Tip::Waiting
        {
            return Ok(false);
        }
        let reach_m = way.norm() + self.sources.piece_m;
        let mut changed = false;
        while let Some((thread, crossing)) = self.comes_back(needle, &curve, reach_m) {
            self.state.threads[thread].drop_last();
            self.take_back(needle, crossing)?;
            changed = true;
        }
        let before = self.state.each[needle].history.before();
        let mesh = &self.sources.mesh;
        let is_led = self
            .chained(needle)
            .is_some_and(|(_, last)| last.to(mesh) == before);
        if before.is_some() && !is_led {
            changed |= self.walk_end_back(needle, &curve)?;
        }
        Ok(changed)
    }

    /// The last face of a thread, where its needle's end has come back to it.
    fn comes_back(&self, needle: usize, curve: &Curve, reach_m: f64) -> Option<(usize, Crossing)> {
        let mesh = &self.sources.mesh;
        let history = &self.state.each[needle].history;
        let (thread, last) = self.chained(needle)?;
        if last.to(mesh) != history.before() {
            return None;
        }
        let point = self.position_of(&anchor(mesh, &last));
        let alpha = curve.project(&point, 0.0);
        if alpha < 0.0 {
            return None;
        }
        if history.before().is_none() {
            // From outside only into the hole itself.
            let thickness_m = self.sources.needles[needle].needle.thickness_m;
            let off_m = (point - curve.at(alpha)).norm();
            if off_m > thickness_m || alpha > reach_m {
                return None;
            }
        }
        let first = history.crossings().first();
        let most = first.map_or(curve.length, |first| first.alpha);
        let alpha = alpha.min(most);
        Some((thread, Crossing { alpha, ..last }))
    }

    /// The needle takes hold, at its end, of a crossing that may be beside it.
    fn take_back(&mut self, needle: usize, crossing: Crossing) -> Result<(), Status> {
        let at = anchor(&self.sources.mesh, &crossing);
        let from = self.position_of(&at);
        let state = &mut self.state.each[needle];
        if !state.history.push_front(crossing) {
            return Err(Status::TooManyRows);
        }
        state.hold_front(self.sources.apart_m);
        self.count_anew(needle, |taken| Some(taken + 1));
        let releases = &mut self.work.needles.releases;
        if releases.len() < releases.capacity() {
            releases.push(Release {
                needle,
                at,
                force: nalgebra::Vector3::zeros(),
                from,
                taken: Some(0),
            });
        }
        Ok(())
    }

    /// Crossings have come before those that were taken hold of, or have gone.
    fn count_anew(&mut self, needle: usize, place: impl Fn(usize) -> Option<usize>) {
        let own = self.work.needles.releases.iter_mut();
        for release in own.filter(|release| release.needle == needle) {
            release.taken = release.taken.and_then(&place);
        }
    }

    /// An end in tissue goes back through the cells, and out.
    fn walk_end_back(&mut self, needle: usize, curve: &Curve) -> Result<bool, Status> {
        let mut history = std::mem::take(&mut self.state.each[needle].history);
        let had = history.crossings().len();
        let walked = {
            let geometry = self.geometry(Slack::Everywhere(0.0));
            walk_back(&geometry, curve, &mut history, curve.length, 0.0)
        };
        let has_room = match walked.stop {
            Stop::Boundary(crossing) => history.push_front(crossing),
            Stop::Full => false,
            Stop::Reached | Stop::Lost => true,
        };
        let found = history.crossings().len() - had;
        let state = &mut self.state.each[needle];
        state.history = history;
        state.tally.guessed += walked.guessed;
        state.tally.lost += u32::from(walked.stop == Stop::Lost);
        state.hold_front(self.sources.apart_m);
        self.count_anew(needle, |taken| Some(taken + found));
        if has_room {
            Ok(found > 0)
        } else {
            Err(Status::TooManyRows)
        }
    }
}
