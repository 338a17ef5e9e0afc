//! How weight and contact force come when a console is armed, and how the weight goes at a fault: never in one tick.
//!
//! Entry points, once a tick: [`Ramps::rise`] while something is rendered, [`Ramps::let_down`] after a fault whose cause leaves
//! the motors alone, [`Ramps::off`] otherwise. An arm that is carried from one tick to the next kicks, and one that is let go
//! of falls on the hand.

use crate::mutant::stands;
use crate::wire::faults;

/// Time in which the whole weight comes or goes \[ticks\]: an arm let go of falls as far as a hand follows without a thought.
const WEIGHT: u16 = 300;
/// Time in which the contact force may come up to its limit after arming \[ticks\]: below a hand's reaction time, far above what
/// is felt as a knock.
const CONTACT: u16 = 50;

/// Faults after which the motors may still carry what they carried, less and less of it. Encoders are not asked for that. After
/// all others nobody knows what the motors, the supply, the clock or the code do, or somebody wants them off.
const LET_DOWN: u16 = faults::ENCODER_JUMP | faults::OUT_OF_REACH | faults::OVERSPEED;

/// Whether these faults, latched, leave the motors alone.
pub(super) fn may_let_down(latched: u16) -> bool {
    latched & !LET_DOWN == 0
}

/// What is there of weight and contact force \[ticks\].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Ramps {
    weight: u16,
    contact: u16,
}

impl Ramps {
    /// A tick that renders. `begins`: the first one after arming, or since the amplifiers take currents.
    pub fn rise(&mut self, begins: bool) {
        if begins {
            self.contact = 0;
        }
        self.weight = (self.weight + 1).min(WEIGHT);
        self.contact = (self.contact + 1).min(CONTACT);
    }

    /// A tick that lets the weight down: what is left of what was carried in the tick before, as a part of it.
    pub fn let_down(&mut self) -> f32 {
        self.contact = 0;
        let before = self.weight.max(1);
        self.weight = before - 1;
        f32::from(self.weight) / f32::from(before)
    }

    /// A tick without torque.
    pub fn off(&mut self) {
        *self = Ramps::default();
    }

    /// Part of the weight that is carried.
    pub fn weight(&self) -> f32 {
        f32::from(self.weight) / f32::from(WEIGHT)
    }

    /// Part of a contact force, and of the largest one, that may be there.
    pub fn contact(&self) -> f32 {
        if !stands("contact_ramp") {
            return 1.0;
        }
        f32::from(self.contact) / f32::from(CONTACT)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weight_and_contact_rise_by_equal_parts_and_stay() {
        let mut ramps = Ramps::default();
        for tick in 1..=1000_u16 {
            ramps.rise(tick == 1);
            let part = |ticks: u16| f32::from(tick.min(ticks)) / f32::from(ticks);
            assert_eq!([ramps.weight(), ramps.contact()], [part(300), part(50)]);
        }
    }

    #[test]
    fn the_weight_goes_as_it_came_and_the_contact_begins_anew() {
        for risen in [1_u16, 20, 299, 300, 400] {
            let mut ramps = Ramps::default();
            (0..risen).for_each(|tick| ramps.rise(tick == 0));
            let full = risen.min(300);
            let mut carried = 1.0;
            for left in (0..full).rev() {
                carried *= ramps.let_down();
                let expected = f32::from(left) / f32::from(full);
                assert!((carried - expected).abs() < 1e-4, "{left}: {carried}");
                assert_eq!(ramps.weight(), f32::from(left) / 300.0);
            }
            assert_eq!((carried, ramps.let_down()), (0.0, 0.0));
        }
        let mut ramps = Ramps::default();
        (0..300).for_each(|tick| ramps.rise(tick == 0));
        ramps.let_down();
        ramps.rise(true);
        assert_eq!([ramps.weight(), ramps.contact()], [1.0, 0.02]);
        ramps.off();
        assert_eq!([ramps.weight(), ramps.contact()], [0.0, 0.0]);
    }

    #[test]
    fn a_cause_that_allows_no_torque_wins() {
        let (gentle, hard): (std::vec::Vec<_>, std::vec::Vec<_>) = faults::NAMES
            .iter()
            .partition(|(bit, _)| may_let_down(*bit));
        let names = |of: &[(u16, &'static str)]| {
            of.iter()
                .map(|(_, name)| *name)
                .collect::<std::vec::Vec<_>>()
        };
        assert_eq!(
            names(&gentle),
            ["encoder_jump", "out_of_reach", "overspeed"]
        );
        for (bit, name) in hard {
            assert!(!may_let_down(bit | faults::OVERSPEED), "{name}");
        }
        // A bit that this version does not know yet.
        assert!(!may_let_down(1 << 15));
    }
}
