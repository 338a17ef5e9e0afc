//! How the parts of a model's thread that nothing draws taut lie in space: for viewers and files.
//!
//! Entry points: [`FreeThread::new`], [`FreeThread::step`]. The thread of the balance has a length and a tension, no
//! shape where it is slack; the shape is that of a chain guided by the faces that the thread goes through and
//! by what holds its ends (Younes 2021, end of 3.3.2). It takes nothing back to the balance, and only exists where
//! somebody asks for it.

use super::chain::{Chain, ChainReport, ChainSettings, Guide};
use super::skin::Skin;
use super::state::MOST_PASSED;
use crate::model::Model;
use crate::step::State;
use nalgebra::Vector3;

/// Two guides are told apart by this part of the thread.
const APART: f64 = 1e-9;
/// Guides at most: all faces, and both ends.
const MOST_GUIDES: usize = MOST_PASSED + 2;

/// A thread with a shape.
#[derive(Clone, Debug)]
pub struct FreeThread {
    id: u8,
    length_m: f64,
    chain: Chain,
    guides: Vec<Guide>,
    skin: Skin,
    /// Where the tissue's nodes are \[m\], (n x 3).
    at: Vec<Vector3<f64>>,
}

impl FreeThread {
    /// Of a model's thread, as it lies in `state`, straight where nothing guides it; nodes about `spacing_m` from each
    /// other, made of what `settings` says for its length. `None` if there is no such thread or nothing can be
    /// made of the numbers.
    pub fn new(
        model: &Model,
        state: &State,
        thread: u8,
        settings: impl FnOnce(f64) -> ChainSettings,
    ) -> Option<Self> {
        let length_m = model.thread_length_m(thread)?;
        let settings = ChainSettings {
            length_m,
            most_guides: MOST_GUIDES,
            ..settings(length_m)
        };
        let nodes_m = state.positions(model);
        let at = places(&nodes_m);
        let mut free = Self {
            id: thread,
            length_m,
            chain: Chain::new(settings, &Vector3::zeros(), &Vector3::x())?,
            guides: Vec::with_capacity(MOST_GUIDES),
            skin: Skin::new(&model.surface().triangles, &at),
            at,
        };
        free.guide(model, state, &nodes_m);
        free.chain.place(&free.guides);
        Some(free)
    }

    /// Moves on by `dt_s`, above zero, to where the thread and the tissue are in `state`. Looks at all of the tissue, as
    /// often as a viewer shows it; allocates.
    pub fn step(&mut self, dt_s: f64, model: &Model, state: &State) -> ChainReport {
        let nodes_m = state.positions(model);
        self.at = places(&nodes_m);
        self.skin.refit(&self.at);
        self.guide(model, state, &nodes_m);
        let tissue = Some((&self.skin, &self.at[..]));
        self.chain.step(dt_s, &self.guides, tissue)
    }

    /// Where its nodes are \[m\], from tail to head.
    pub fn nodes_m(&self) -> impl Iterator<Item = [f64; 3]> {
        self.chain.nodes_m().iter().map(|at| (*at).into())
    }

    /// The points of its path that the thread is held at, from tail to head: where they are along it, counted from its tail \[m\],
    /// where they are \[m\], (3), and with what force it pulls them there \[N\], (3): its weight and bending, beside the tension of
    /// the balance.
    pub fn guides(&self) -> impl Iterator<Item = (f64, [f64; 3], [f64; 3])> {
        let guides = self.guides.iter().enumerate();
        guides.map(|(index, guide)| (guide.along_m, guide.at_m, self.chain.pull_n(index).into()))
    }

    fn guide(&mut self, model: &Model, state: &State, nodes_m: &[[f64; 3]]) {
        self.guides.clear();
        for point in state.thread_path(model, self.id, nodes_m) {
            // Places on the thread are counted back from its head.
            let along_m = (self.length_m + point.along_m).clamp(0.0, self.length_m);
            let at_m = point.at_m;
            let before = self.guides.last().map(|guide| guide.along_m);
            if before.is_none_or(|before| along_m > before + APART * self.length_m) {
                self.guides.push(Guide { along_m, at_m });
            }
        }
    }
}

fn places(positions: &[[f64; 3]]) -> Vec<Vector3<f64>> {
    positions.iter().map(|at| Vector3::from(*at)).collect()
}
