//! What watches over the force, by name, to be switched off one at a time: the console's guards, and what a host does about its
//! being late.
//!
//! Entry points: [`Switch::all`], [`Spec::without`](super::spec::Spec::without). The console's switches are its own; those of the
//! host act on what its solver gives, here alone: no session has them.

use super::scenes::{Sample, Solution};
use sutura_host::session::Horizon;
use sutura_shared::control::Guards;

/// Names of guards, and whether each is on.
pub fn guards_by_name(guards: &Guards) -> [(&'static str, bool); 20] {
    [
        ("blend", guards.blend),
        ("trust", guards.trust),
        ("lead", guards.lead),
        ("bend", guards.bend),
        ("swing", guards.swing),
        ("tank", guards.tank),
        ("along", guards.along),
        ("credit", guards.credit),
        ("damping", guards.damping),
        ("horizon", guards.horizon),
        ("force", guards.force),
        ("slew", guards.slew),
        ("power", guards.power),
        ("overspeed", guards.overspeed),
        ("residual", guards.residual),
        ("rubs", guards.rubs),
        ("emergency_stop", guards.emergency_stop),
        ("encoder_jump", guards.encoder_jump),
        ("encoder_burst", guards.encoder_burst),
        ("disarm", guards.disarm),
    ]
}

/// All guards but one; all for a name that is none.
pub fn all_but(name: &str) -> Guards {
    let mut guards = Guards::ALL;
    guards.switch_off(name);
    guards
}

/// What a host does about its being late, on or off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mendings {
    /// While the tool is apart, the slope and the rows of what it comes down to are sent.
    pub foretold: bool,
    /// Hands that set out from rest are foreseen: so is what lies beyond the way that their velocity takes them.
    pub sets_out: bool,
    /// Contacts are solved for where the grip will be across their normal.
    pub ahead: bool,
    /// As long as nothing is known of a link, a solve may take five periods.
    pub longer_start: bool,
    /// Where there is time steps over tissue that is not linear take more passes, and the way that the hand goes is tried.
    pub tries: bool,
    /// The console is told how far what rubs slipped on the way to the frame's pose, and takes back what the grip did not do.
    pub slips: bool,
}

/// Ticks and delay \[us\] of a link that is known to be quick.
const KNOWN_TICKS: u32 = 5_500;
const KNOWN_US: u32 = 2_000;

impl Mendings {
    /// All of them.
    pub const ALL: Mendings = Mendings {
        foretold: true,
        sets_out: true,
        ahead: true,
        longer_start: true,
        tries: true,
        slips: true,
    };

    /// Their names, and whether each is on.
    pub fn by_name(&self) -> [(&'static str, bool); 6] {
        [
            ("foretold", self.foretold),
            ("sets-out", self.sets_out),
            ("ahead", self.ahead),
            ("longer-start", self.longer_start),
            ("tries", self.tries),
            ("slips", self.slips),
        ]
    }

    /// What is sent of a solution, of which frames are in use until `ahead_s` after its state. Without `sets_out` nothing is
    /// foretold as a whole that the velocity does not reach; in a session that goes node by node.
    pub(super) fn of(&self, mut solution: Solution, sample: &Sample, ahead_s: f64) -> Solution {
        let pairs = sample.velocity_m_per_s.iter().zip(&solution.normal);
        let nears: f64 = -pairs.map(|(v, n)| v * n).sum::<f64>();
        let is_reached = solution.gap_m < nears.max(0.0) * ahead_s;
        let is_told = self.foretold && (self.sets_out || is_reached);
        if solution.gap_m > 0.0 && !is_told {
            solution.tangent = [[0.0; 6]; 6];
            solution.rows = None;
        }
        if let Some(rows) = solution.rows.as_mut().filter(|_| !self.slips) {
            rows.slip_m.fill(0.0);
        }
        solution
    }

    /// The horizon of a host that sends `host_hz` frames a second.
    pub(super) fn horizon(&self, host_hz: f64) -> Horizon {
        let mut horizon = Horizon::new(host_hz);
        if !self.longer_start {
            for tick in 0..=KNOWN_TICKS {
                horizon.tick(tick);
                horizon.applied(KNOWN_US);
            }
        }
        horizon
    }

    /// The console's number of a tick of the run, for that horizon.
    pub(super) fn console_tick(&self, tick: u32) -> u32 {
        if self.longer_start {
            tick
        } else {
            tick + KNOWN_TICKS
        }
    }
}

/// One switch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Switch {
    /// A guard of the console's.
    Guard(&'static str),
    /// Something of the host's.
    Mending(&'static str),
}

impl Switch {
    /// All of them.
    pub fn all() -> Vec<Switch> {
        let guards = guards_by_name(&Guards::ALL).map(|(name, _)| Switch::Guard(name));
        let mendings = Mendings::ALL
            .by_name()
            .map(|(name, _)| Switch::Mending(name));
        guards.into_iter().chain(mendings).collect()
    }

    /// As tables print it.
    pub fn name(self) -> &'static str {
        match self {
            Switch::Guard(name) | Switch::Mending(name) => name,
        }
    }

    /// What is left without it.
    pub(super) fn off(self) -> (Guards, Mendings) {
        let (mut guards, mut mendings) = (Guards::ALL, Mendings::ALL);
        match self {
            Switch::Guard(name) => {
                guards.switch_off(name);
            }
            Switch::Mending("foretold") => mendings.foretold = false,
            Switch::Mending("sets-out") => mendings.sets_out = false,
            Switch::Mending("ahead") => mendings.ahead = false,
            Switch::Mending("tries") => mendings.tries = false,
            Switch::Mending("slips") => mendings.slips = false,
            Switch::Mending(_) => mendings.longer_start = false,
        }
        (guards, mendings)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_switch_switches_one_thing_off() {
        for switch in Switch::all() {
            let (guards, mendings) = switch.off();
            let console = guards_by_name(&guards).into_iter();
            let off: Vec<_> = console
                .chain(mendings.by_name())
                .filter_map(|(name, on)| (!on).then_some(name))
                .collect();
            assert_eq!(off, [switch.name()]);
        }
    }

    /// Three periods at 60 Hz, and five more where nothing is known.
    #[test]
    fn without_its_longer_start_a_host_knows_its_link() {
        let known = Mendings {
            longer_start: false,
            ..Mendings::ALL
        };
        assert_eq!(Mendings::ALL.horizon(60.0).next_us(), 8 * 16_667);
        assert_eq!(known.horizon(60.0).next_us(), 3 * 16_667 + KNOWN_US);
    }
}
