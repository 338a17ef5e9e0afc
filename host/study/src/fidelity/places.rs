//! What is touched in the cases, by name, and what all cases of a run share of it.
//!
//! Entry points: [`Place`], [`Scenes::load`].

use super::hand::Motion;
use super::returns;
use super::run::{True, truth_along};
use super::scenes::Scene;
use super::scenes::needle::NeedleSlabs;
use super::scenes::palpation::Palpation;
use super::scenes::point::Point;
use super::scenes::rogue::Rogue;
use super::scenes::round::Round;
use super::scenes::slab::{Law, Slab};
use super::scenes::thread::WoundSlabs;
use super::spec::Spec;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use sutura_host::scene::SceneError;
use sutura_shared::device::DeviceError;

/// Coefficient of friction of tools that rub: of rubber on wet tissue.
const FRICTION: f64 = 0.3;
pub(super) static RUBBED_THIN: Round = Round::THIN.rubbed(FRICTION);
pub(super) static RUBBED_THICK: Round = Round::THICK.rubbed(FRICTION);

/// Which scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Place {
    /// [`Point`].
    Point,
    /// [`Point::GRISTLE`].
    Gristle,
    /// [`Palpation`].
    Palpation,
    /// The same with a tool that rubs, of a coefficient of 0.3.
    Rubbing,
    /// [`NeedleSlabs`].
    Needle,
    /// [`WoundSlabs`].
    Thread,
    /// [`Rogue`].
    Rogue(Rogue),
    /// [`Round::THIN`].
    RoundThin,
    /// [`Round::THICK`].
    RoundThick,
    /// [`Round::THIN`] with a tool that rubs.
    RubbingThin,
    /// [`Round::THICK`] with a tool that rubs.
    RubbingThick,
    /// [`Slab`].
    Slab(Law),
}

/// Scenes and true forces that cases share.
pub struct Scenes {
    palpation: Palpation,
    rubbing: Palpation,
    needle: NeedleSlabs,
    thread: WoundSlabs,
    corotational: Slab,
    hyperelastic: Slab,
    known: Mutex<HashMap<(Place, Motion, u32), Known>>,
    rests: Mutex<HashMap<(Place, Motion, String), Rest>>,
}

/// Solved by whoever needs it first.
type Known = Arc<OnceLock<Vec<True>>>;
/// Where a hand rests \[m\].
type Rest = Arc<OnceLock<Result<f64, DeviceError>>>;

impl Scenes {
    /// Builds them.
    ///
    /// # Errors
    /// None unless a shipped scene is not sound.
    pub fn load() -> Result<Self, SceneError> {
        Ok(Scenes {
            palpation: Palpation::load(0.0)?,
            rubbing: Palpation::load(FRICTION)?,
            needle: NeedleSlabs::load()?,
            thread: WoundSlabs::load()?,
            corotational: Slab::load(Law::Corotational)?,
            hyperelastic: Slab::load(Law::Hyperelastic)?,
            known: Mutex::default(),
            rests: Mutex::default(),
        })
    }

    pub(super) fn at<'a>(&'a self, place: &'a Place) -> &'a dyn Scene {
        match place {
            Place::Point => &Point::TISSUE,
            Place::Gristle => &Point::GRISTLE,
            Place::Palpation => &self.palpation,
            Place::Rubbing => &self.rubbing,
            Place::Needle => &self.needle,
            Place::Thread => &self.thread,
            Place::Rogue(rogue) => rogue,
            Place::RoundThin => &Round::THIN,
            Place::RoundThick => &Round::THICK,
            Place::RubbingThin => &RUBBED_THIN,
            Place::RubbingThick => &RUBBED_THICK,
            Place::Slab(Law::Corotational) => &self.corotational,
            Place::Slab(Law::Hyperelastic) => &self.hyperelastic,
        }
    }

    pub(super) fn known(&self, spec: &Spec) -> Known {
        let key = (spec.place, spec.motion, (spec.seconds * 1e3) as u32);
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let slot = Arc::clone(known.entry(key).or_default());
        // Others may look up theirs meanwhile.
        drop(known);
        slot.get_or_init(|| truth_along(self.at(&spec.place), spec.motion, spec.seconds));
        slot
    }
    /// Where the hand of a case of [`returns`] rests \[m\].
    pub(super) fn rest_m(&self, spec: &Spec) -> Result<f64, DeviceError> {
        let key = (spec.place, spec.motion, spec.grasp.word());
        let mut rests = self.rests.lock().unwrap_or_else(PoisonError::into_inner);
        let slot = Arc::clone(rests.entry(key).or_default());
        drop(rests);
        *slot.get_or_init(|| returns::rest_m(spec, self))
    }
}
