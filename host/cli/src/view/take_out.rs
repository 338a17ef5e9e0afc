//! Takes a tool out of the tissue that it has slipped into, at a page's request.
//!
//! Entry point: [`TakeOut::way`]: the console is disarmed, its hand follows ways until the tool is clear, and it is armed again.

use super::guide::Guide;
use nalgebra::Vector3;
use sutura_host::scene::{Pose, Scene, joints_at};
use sutura_host::session::{Plan, SceneSolver, WayOut};
use sutura_shared::device::DeviceDescription;
use sutura_shared::wire::message::{HandScript, State};

/// Wait between the end of the way and arming, in which the hand's spring comes to rest \[s\].
pub const RESTS_S: f64 = 0.2;
/// Further ways if the hand's spring has left the tool short of the first one's end.
pub const MORE_WAYS: u8 = 3;
/// Refusal for a tool that is clear already, and the next step.
pub const IS_CLEAR: (&str, &str) = (
    "the tool is not in the tissue",
    "arm the console; if it lets go again the tool is behind what is held, and `Start again` begins with the tool outside",
);
/// Words for a tool that all of them have left in the tissue.
pub const STILL_INSIDE: &str = "the tool is still in the tissue, and the console stays disarmed: `Start again` begins with the tool outside";

/// Ways out of a scene's tissue for a simulated console.
pub struct TakeOut {
    ways: WayOut,
    device: DeviceDescription,
}

/// Pose of the grip in a state.
pub fn grip(state: &State) -> Pose {
    Pose {
        position_m: state.position_m.map(f64::from),
        orientation: state.orientation.map(f64::from),
    }
}

/// Place from which a way out is counted, and begins. The hand is a spring: motors and friction keep the grip away from its target.
#[derive(Clone, Copy, Debug)]
pub enum Start {
    /// The grip, for the first way: the force of the motors ends with it.
    Grip,
    /// The hand's target, for a further way: friction holds the grip back.
    Hand,
}

/// Why there is no way, and what helps.
pub type NoWay = (String, &'static str);

impl TakeOut {
    /// Builds it for a scene whose solver is at rest; none if the console's grip carries nothing that touches.
    pub fn of(scene: &Scene, solver: &SceneSolver, plan: &Plan) -> Option<Self> {
        Some(Self {
            ways: WayOut::of(scene, &solver.positions_m())?,
            device: plan.device,
        })
    }

    /// Returns the hand's targets for a grip at a pose, and their duration \[s\]; none if the tool is clear already and the last solve has
    /// not found that it had `slipped` in.
    ///
    /// # Errors
    /// There is no way, or the console does not reach to its end.
    pub fn way(
        &self,
        guide: &mut Guide,
        now_s: f64,
        grip: &Pose,
        start: Start,
        slipped: bool,
    ) -> Result<Option<(HandScript, f64)>, NoWay> {
        let help = "`Start again` begins with the tool outside";
        let out = self.ways.from(grip, slipped).ok_or_else(|| {
            (
                "there is no way out of the tissue from here".to_owned(),
                help,
            )
        })?;
        if out == [0.0; 3] {
            return Ok(None);
        }
        let from = match start {
            Start::Grip => grip.position_m,
            Start::Hand => guide.at(now_s),
        };
        let to: [f64; 3] = (Vector3::from(from) + Vector3::from(out)).into();
        let kinematics = &self.device.kinematics;
        match (
            joints_at(kinematics, grip.position_m),
            joints_at(kinematics, to),
        ) {
            (Some(start_joint), Some(_)) => {
                Ok(Some(guide.take_out(now_s, [from, to], start_joint)))
            }
            _ => {
                let [x, y, z] = to.map(|along| 1e3 * along);
                let message = format!(
                    "the way out leads to ({x:.0}, {y:.0}, {z:.0}) mm, where the console does not reach"
                );
                Err((message, help))
            }
        }
    }
}
