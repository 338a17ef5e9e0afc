//! Takes a tool out of the tissue that it has slipped into, at a page's request.
//!
//! Entry point: [`TakeOut::way`]: the console is disarmed, its hand follows this way, and it is armed again.

use super::guide::Guide;
use sutura_host::scene::{Pose, Scene, joints_at};
use sutura_host::session::{Plan, SceneSolver, WayOut};
use sutura_shared::device::DeviceDescription;
use sutura_shared::wire::message::{HandScript, State};

/// Wait between the end of the way and arming, in which the hand's spring comes to rest \[s\].
pub const RESTS_S: f64 = 0.2;

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

    /// Returns the hand's targets for a grip at a pose, and their duration \[s\].
    ///
    /// # Errors
    /// The tool is free already, or the console does not reach to where it would be.
    pub fn way(
        &self,
        guide: &mut Guide,
        now_s: f64,
        grip: &Pose,
    ) -> Result<(HandScript, f64), NoWay> {
        let help = "`Start again` begins with the tool outside";
        let out = self.ways.from(grip).ok_or_else(|| {
            (
                "there is no way out of the tissue from here".to_owned(),
                help,
            )
        })?;
        if out == [0.0; 3] {
            let message = "the tool is not in the tissue".to_owned();
            return Err((message, "arm the console"));
        }
        // The hand is a spring that the grip hangs from: it goes as far as the grip is to go.
        let from = guide.at(now_s);
        let to = [0, 1, 2].map(|axis: usize| from[axis] + out[axis]);
        let kinematics = &self.device.kinematics;
        match (
            joints_at(kinematics, grip.position_m),
            joints_at(kinematics, to),
        ) {
            (Some(start_joint), Some(_)) => Ok(guide.take_out(now_s, to, start_joint)),
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
