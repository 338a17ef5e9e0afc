//! What a session needs to know, and the orders that begin and end it.
//!
//! Entry points: [`Plan`], [`Plan::opening_orders`]. The same orders go to every console; only a simulated
//! one is also told which device it is and what its hand does.

use super::budget::{most_rows, usb_bytes_per_s};
use super::fault_names;
use super::horizon::LONGEST_US;
use crate::link::{LinkError, Order};
use crate::scene::{Rendering, Scene, SceneError, built_in_device};
use miette::Diagnostic;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sutura_shared::control::TICK_HZ;
use sutura_shared::device::DeviceDescription;
use sutura_shared::wire::message::{Command, Fixture, HandScript, Hello, Mode, Simulate, State};
use sutura_shared::wire::validate::name;

/// How long a console may take to arm \[ms of console time\]: a few ticks, and the orders' way over a slow line.
pub(super) const ARM_WITHIN_MS: u32 = 3000;
/// `Arm` is repeated this often while the console is idle \[ms of console time\]: a simulated console that
/// has just become another device must run one tick before it obeys.
pub(super) const ARM_AGAIN_MS: u32 = 100;

/// What a session is to be.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// The device that a simulated console becomes.
    pub device: DeviceDescription,
    /// What the hand on a simulated console does.
    pub hand: HandScript,
    /// Solver steps a second \[Hz\], above 0.
    pub host_hz: f64,
    /// Console time from the first armed state to the end \[s\].
    pub seconds: f64,
    /// Control rate that the host expects \[Hz\].
    pub tick_hz: u16,
    /// Ticks between two states; 1 unless the line is slow.
    pub state_every: u16,
    /// What the console is given to render from.
    pub rendering: Rendering,
    /// What the line carries, both ways together, and the board at its end has time for \[bytes/s\].
    pub line_bytes_per_s: f64,
    /// Shortest horizon of a frame \[us\]; measured delays make it longer, up to what consoles cap it at.
    pub horizon_us: Option<u32>,
    /// Clear a fault that is latched from before; its cause must be gone.
    pub clear_fault: bool,
    /// What the console renders by itself, beside the scene.
    pub fixture: Fixture,
}

/// What of a plan may change while a session runs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Tuning {
    /// Solver steps a second \[Hz\], above 0.
    pub host_hz: f64,
    /// What the console is given to render from.
    pub rendering: Rendering,
}

/// Why a scene asks for no session.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum PlanError {
    /// A simulated console would hang in the air.
    #[error("the scene \"{scene}\" has no hand to hold a virtual console")]
    #[diagnostic(help("add a [hand] section as in scenes/palpation.toml"))]
    NoHand {
        /// Its name.
        scene: String,
    },
    /// Its device is unusable.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Device(#[from] SceneError),
}

/// Why a session did not run to its end.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// There is no link, or no longer one.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// A fault was latched before the session began.
    #[error(
        "the console is in a latched fault: {}",
        super::fault_words::said(faults)
    )]
    Fault {
        /// Names of the faults.
        faults: Vec<String>,
    },
    /// A console with motors is another device than the session was made for.
    #[error("the console is `{console}`, and the session is for `{device}`")]
    OtherDevice {
        /// As the console calls itself.
        console: String,
        /// As the scene calls its device.
        device: String,
    },
    /// The console did not arm.
    #[error("the console did not arm within {} s; it is {mode}", f64::from(ARM_WITHIN_MS) / 1e3)]
    NotArmed {
        /// Its mode.
        mode: &'static str,
    },
    /// The solver's thread ended by a panic; the console lets its force decay.
    #[error("the solver failed; the console lets its force decay by itself")]
    Solver,
    /// Contacts would come when the console may not use the last one any more.
    #[error(
        "{host_hz} solves a second: a contact is used for {longest_ms:.0} ms at most, and the next one would come later"
    )]
    TooSlow {
        /// Solver steps a second \[Hz\].
        host_hz: f64,
        /// What every console caps the horizon at \[ms\].
        longest_ms: f64,
        /// The slowest that does \[Hz\].
        least_hz: f64,
    },
    /// No state that can be used came for so long that the console must be taken for dead.
    #[error("no state that can be used came from the console for {waited_s} s: {heard}")]
    Silent {
        /// How long the host waited \[s\].
        waited_s: f64,
        /// States that came instead, in words.
        heard: String,
    },
}

impl Plan {
    /// The session that a scene asks for, over USB.
    ///
    /// # Errors
    /// [`PlanError`]: a scene without a hand, or a device that is unusable.
    pub fn of_scene(scene: &Scene) -> Result<Plan, PlanError> {
        let device = match scene.device {
            Some(device) => device,
            None => built_in_device()?,
        };
        let hand = scene.hand.ok_or_else(|| PlanError::NoHand {
            scene: scene.name.clone(),
        })?;
        Ok(Plan {
            device: device.description,
            hand,
            host_hz: scene.host.host_hz,
            seconds: scene.seconds,
            tick_hz: TICK_HZ,
            state_every: 1,
            horizon_us: scene.host.horizon_us,
            clear_fault: false,
            fixture: Fixture::None,
            rendering: scene.usual_rendering(),
            line_bytes_per_s: usb_bytes_per_s(device.board_rows_hz),
        })
    }

    /// Most rows that a contact may have for line and board to take them all; 0: none are sent.
    pub fn most_rows(&self) -> usize {
        match self.rendering {
            Rendering::Rows => {
                let state_hz = f64::from(self.tick_hz) / f64::from(self.state_every.max(1));
                most_rows(self.line_bytes_per_s, self.host_hz, state_hz)
            }
            Rendering::Hold | Rendering::Tangent => 0,
        }
    }

    /// What of it may change.
    pub fn tuning(&self) -> Tuning {
        let Plan {
            host_hz, rendering, ..
        } = *self;
        Tuning { host_hz, rendering }
    }

    /// The same with another tuning.
    pub fn tuned(&self, to: &Tuning) -> Plan {
        let Tuning { host_hz, rendering } = *to;
        Plan {
            host_hz,
            rendering,
            ..*self
        }
    }

    /// What the console is told before it is armed, in order.
    ///
    /// # Errors
    /// [`SessionError::OtherDevice`]: forces and limits were chosen for another one.
    pub(super) fn opening_orders(&self, console: &Hello) -> Result<Vec<Order>, SessionError> {
        // A simulated one becomes whatever it is told.
        if !console.simulated && console.device_name != self.device.name {
            let word = |bytes: &[u8; 16]| name(bytes).unwrap_or_default().to_owned();
            return Err(SessionError::OtherDevice {
                console: word(&console.device_name),
                device: word(&self.device.name),
            });
        }
        let mut orders = Vec::new();
        if self.state_every != 1 {
            orders.push(Order::Command(Command::StateEvery {
                ticks: self.state_every,
            }));
        }
        if self.clear_fault {
            orders.push(Order::Command(Command::ClearFault));
        }
        if console.simulated {
            orders.push(Order::Simulate(Simulate::Device(self.device)));
            orders.push(Order::Simulate(Simulate::Hand(self.hand)));
        }
        if self.fixture != Fixture::None {
            orders.push(Order::Fixture(self.fixture));
        }
        orders.push(Order::Command(Command::Arm));
        Ok(orders)
    }

    /// What a console is told that came back after the link was lost; it is not armed. A simulated one that has not
    /// started anew is the device already, and its hand goes on.
    ///
    /// # Errors
    /// As [`Self::opening_orders`]: it may be another one.
    pub(super) fn orders_again(
        &self,
        console: &Hello,
        started_anew: bool,
    ) -> Result<Vec<Order>, SessionError> {
        let mut orders = self.opening_orders(console)?;
        orders.retain(|order| match order {
            Order::Command(command) => matches!(command, Command::StateEvery { .. }),
            Order::Simulate(_) => started_anew,
            Order::Fixture(_) => true,
        });
        Ok(orders)
    }

    /// Control ticks that the session lasts, at least one.
    pub(super) fn ticks(&self) -> u64 {
        ((self.seconds * f64::from(self.tick_hz)).round() as u64).max(1)
    }

    /// Name of the device that the session is with.
    pub(super) fn device_name(&self, console: &Hello) -> String {
        let bytes = if console.simulated {
            &self.device.name
        } else {
            &console.device_name
        };
        // Both have been checked: the scene's when it was loaded, the console's when it was received.
        name(bytes).unwrap_or_default().to_owned()
    }
}

/// Fewest solves a second of which each contact is there before the last one may not be used any more \[Hz\].
pub fn least_hz(tick_hz: u16) -> f64 {
    // One that is solved for a state is there a period later, and is used for another.
    let longest_s = 1e-6 * LONGEST_US as f64;
    (2.0 / (longest_s - 2.0 / f64::from(tick_hz))).ceil()
}

/// Whether contacts at this rate are there before the last one may not be used any more.
///
/// # Errors
/// [`SessionError::TooSlow`].
pub fn check_rate(host_hz: f64, tick_hz: u16) -> Result<(), SessionError> {
    let least_hz = least_hz(tick_hz);
    if host_hz >= least_hz {
        return Ok(());
    }
    Err(SessionError::TooSlow {
        host_hz,
        longest_ms: 1e-3 * LONGEST_US as f64,
        least_hz,
    })
}

/// Whether the console is armed by now, or never will be.
pub(super) enum Arming {
    Armed,
    NotYet,
    /// Tell it again.
    Again,
}

/// Judges a state that came while the console should arm.
pub(super) struct ArmingWatch {
    first_tick: Option<u32>,
    asked_tick: u32,
    tick_hz: u32,
    clear_fault: bool,
}

impl ArmingWatch {
    pub(super) fn new(plan: &Plan) -> Self {
        let tick_hz = u32::from(plan.tick_hz);
        ArmingWatch {
            first_tick: None,
            asked_tick: 0,
            tick_hz,
            clear_fault: plan.clear_fault,
        }
    }

    pub(super) fn judge(&mut self, state: &State) -> Result<Arming, SessionError> {
        let first = *self.first_tick.get_or_insert_with(|| {
            self.asked_tick = state.tick;
            state.tick
        });
        let ms =
            |since: u32| u64::from(state.tick.wrapping_sub(since)) * 1000 / u64::from(self.tick_hz);
        let waited_ms = ms(first);
        match state.mode {
            Mode::Armed | Mode::Decaying => Ok(Arming::Armed),
            // What was latched before needs a moment to be cleared.
            Mode::Fault if !self.clear_fault || waited_ms >= u64::from(ARM_AGAIN_MS) => {
                Err(SessionError::Fault {
                    faults: fault_names(state.faults),
                })
            }
            mode if waited_ms >= u64::from(ARM_WITHIN_MS) => Err(SessionError::NotArmed {
                mode: super::mode_word(mode),
            }),
            _ if ms(self.asked_tick) >= u64::from(ARM_AGAIN_MS) => {
                self.asked_tick = state.tick;
                Ok(Arming::Again)
            }
            _ => Ok(Arming::NotYet),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene;

    /// A board that has time for 60 frames a second: all rows up to there, fewer beyond it, and the tangent alone far beyond.
    #[test]
    fn a_session_sends_no_more_rows_than_the_board_has_time_for() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../scenes/palpation.toml");
        let mut scene = scene::load(path.as_ref()).expect("a scene that ships");
        let most = |scene: &Scene, host_hz| {
            let plan = Plan::of_scene(scene).expect("it has a hand");
            Plan { host_hz, ..plan }.most_rows()
        };
        assert_eq!([60.0, 80.0, 150.0].map(|hz| most(&scene, hz)), [24; 3]);
        let device = scene.device.as_mut().expect("it has a device");
        device.board_rows_hz = Some(60.0);
        assert_eq!(most(&scene, 60.0), 24);
        assert!((12..24).contains(&most(&scene, 80.0)));
        assert_eq!(most(&scene, 240.0), 0);
    }
}
