//! What the console has taken from the hand and given back, and how much of a force that pays for.
//!
//! Entry points: [`Passivity::book`] first in every tick, [`Passivity::allow`] for the force that is wanted,
//! [`Passivity::commit`] for the efforts that went to the motors. A passivity observer (Hannaford and Ryu 2002) whose
//! balance is a tank (Lee and Huang 2010, passive set-position modulation), in joint space, where the work between two
//! samples is exact: the effort that acted, known from the device's delay, times the way. Two bounds hang on it. What
//! a force can give back before the next tick could change it must be in the tank; and a force that no motion has
//! built up (energy bounding, Kim and Ryu 2010) must be one whose spring the tank could have loaded. What an outage takes
//! away comes back on credit, see [`super::credit`]. All of it is in terms of work and of what is the same in all axes.

use super::TICK_S;
use super::credit::Credit;
use super::tuning::Guards;
use crate::device::{DeviceDescription, JOINTS, MAX_ACTUATION_DELAY_US};
use crate::kinematics::Pose;
use crate::math::{Vec3, clamp, dot, max, min};

/// Commands that may be under way, and the one that is just acting.
const DELAYED: usize = (MAX_ACTUATION_DELAY_US / 1000) as usize + 1;
/// What the tank holds at the start \[J\]: below the work of a few newtons along an encoder's step the ledger cannot tell, and
/// tissue that hardens while no frame comes takes a few tenths of a millijoule less than it gives back.
const CREDIT_J: f32 = 0.5e-3;
/// What the tank may hold beyond what the present contact can have stored \[J\]: what a swap costs at most on a
/// contact that has dissipated it before.
const RESERVE_J: f32 = 3e-3;
/// Stored by the present contact, at most, over force^2 / (2 stiffness): tissue hardens, and tangents are wrong by
/// a factor.
const STORED: f32 = 2.0;
/// Share per tick of what is beyond that which leaks: a time constant of 1 s, far longer than a gap in the frames,
/// for the hand has paid for what it pressed before; no more, for what it rubbed is no store.
const LEAK: f32 = TICK_S;
/// The same of what pays back what is owed: a tenth of a second out of contact does.
const PAID: f32 = 10.0 * TICK_S;
/// Part of a force, and size \[N\], that a finger notices when they are missing.
const NOTICED: (f32, f32) = (0.1, 0.03);
/// Part of a force, and size \[N\], whose lack brings it back to a hand that rests: half of what is noticed.
const LACKS: (f32, f32) = (0.05, 0.03);
/// Speed below which a grip rests \[m/s\]: an encoder's step looks faster than it is.
const RESTS: f32 = 0.01;
/// Time constant of the mean speed of a grip \[s\].
const MEAN_S: f32 = 0.1;
/// Part of the tank that one tick may plan to give: the hand's own acceleration is not known.
const SHARE: f32 = 0.7;
/// Stiffness with which a force must be covered by the tank, over that of the local model: what wrong tangents
/// are wrong by.
const COVER: f32 = 1.5;
/// Stiffness below which a local model says nothing about what it stores \[N/m\].
const SOFTEST: f32 = 100.0;
/// With so little in the tank \[J\] half of the force is gone, whatever the direction.
const OVERDRAWN_J: f32 = -0.5e-3;
/// Dead band of what is booked, to either side \[counts\]: more than half of one, or going to and fro would be booked.
const BAND: f32 = 0.6;
/// Changes of force by a count from which on there is a dead band, and all of it \[N\]: below them a count is not felt, and its work is
/// less than what hand and device take.
const FELT_N: (f32, f32) = (0.015, 0.03);
/// Slower motion is not damped \[m/s\]: an encoder's step looks like that.
const SLOWEST: f32 = 2e-3;
/// Largest damping over mass per period of the actuation: a tenth of what would stop the grip in that time.
const DAMPING: f32 = 0.1;

/// The ledger, and the commands that it still has to book.
#[derive(Clone, Copy, Debug)]
pub(super) struct Passivity {
    guards: Guards,
    /// Energy taken from the hand and not given back, with what is lent, less the leak \[J\].
    energy_j: f32,
    credit: Credit,
    /// See [`withholds`](Self::withholds).
    withholds: bool,
    /// Efforts of the contact force at the last ticks, the newest first.
    efforts: [[f32; JOINTS]; DELAYED],
    /// Ticks from a command until it acts: whole ones, and the part of one after them.
    whole: usize,
    part: f32,
    inertia: [f32; JOINTS],
    damping: [f32; JOINTS],
    /// 1 / largest change of effort in a tick.
    per_step: [f32; JOINTS],
    /// Largest damping over mass \[1/s\].
    damping_per_s: f32,
    /// What the joints moved since the last tick.
    moved: [f32; JOINTS],
    /// Coordinate of a count.
    count: [f32; JOINTS],
    /// Motion of the joints ahead of what is booked, and the most of it.
    ahead: [f32; JOINTS],
    band: [f32; JOINTS],
    /// Force at the last tick \[N\].
    before_n: f32,
    /// Mean velocity of the grip \[m/s\].
    mean: Vec3,
    /// Work of tissue that came towards the tool by itself, and has not gone back \[J\].
    drifted_j: f32,
}

/// What the local model says of the force that is wanted.
#[derive(Clone, Copy, Debug)]
pub(super) struct Local {
    /// Least stiffness that the model may have along the force \[N/m\].
    pub along: f32,
    /// Largest stiffness that it may have along any direction \[N/m\].
    pub most: f32,
    /// Part of its force that its age leaves, 0 to 1; 0 where there is none.
    pub left: f32,
    /// For how long it is good \[s\].
    pub horizon_s: f32,
    /// It has no force at this place, whatever of another model still fades.
    pub is_apart: bool,
    /// Part of the model's force that arming lets through by now, 0 to 1.
    pub ramp: f32,
    /// Speed at which the tissue's surface comes towards the tool by itself \[m/s\].
    pub drift_m_per_s: f32,
}

/// What a force would do until it can be changed.
struct Forecast {
    /// Work of what is under way \[J\].
    under_way_j: f32,
    /// Work of the force itself, linear and quadratic in it \[J\].
    linear_j: f32,
    quadratic_j: f32,
}

impl Passivity {
    pub fn new(device: &DeviceDescription, guards: Guards) -> Self {
        let ticks = device.actuation_delay_us as f32 * 1e-3;
        let whole = (device.actuation_delay_us / 1000) as usize;
        // What nothing bounds needs no credit.
        let guards = Guards {
            credit: guards.credit && guards.tank,
            ..guards
        };
        Passivity {
            guards,
            energy_j: CREDIT_J,
            credit: Credit::NEW,
            withholds: false,
            efforts: [[0.0; JOINTS]; DELAYED],
            whole,
            part: ticks - whole as f32,
            inertia: device.joints.map(|joint| joint.inertia),
            damping: device.joints.map(|joint| joint.damping),
            per_step: device
                .joints
                .map(|joint| 1.0 / (joint.max_slew_per_s * TICK_S)),
            damping_per_s: DAMPING / (TICK_S * (1.0 + ticks)),
            moved: [0.0; JOINTS],
            count: device.joints.map(|joint| 1.0 / joint.counts_per_unit.abs()),
            ahead: [0.0; JOINTS],
            band: [0.0; JOINTS],
            before_n: 0.0,
            mean: Vec3::zeros(),
            drifted_j: 0.0,
        }
    }

    /// Energy in the tank, less what is lent of it \[J\].
    pub fn energy_j(&self) -> f32 {
        self.energy_j - self.credit.owed_j()
    }

    /// Lent of it, and not paid back \[J\].
    pub fn owed_j(&self) -> f32 {
        self.credit.owed_j()
    }

    /// Whether so much less was allowed at this tick than was wanted that a finger notices it.
    pub fn withholds(&self) -> bool {
        self.withholds
    }

    /// Books the work since the last tick, in which the joints moved by `moved`: what went against the force was
    /// taken from the hand.
    pub fn book(&mut self, moved: &[f32; JOINTS]) {
        let acting = self.efforts.get(self.whole).copied().unwrap_or_default();
        let older = self.efforts.get(self.whole + 1).copied().unwrap_or(acting);
        let booked = self.beyond_band(moved);
        let work = acting.iter().zip(&older).zip(&booked);
        self.energy_j -= work.fold(0.0, |sum, ((acting, older), moved)| {
            sum + (acting + (older - acting) * self.part) * moved
        });
        self.moved = *moved;
    }

    /// Motion of the joints beyond a dead band around what has been booked: a grip that rests on the edge of a count moves to and
    /// fro by one, and the force of the count before, which still acts, would give energy with each.
    fn beyond_band(&mut self, moved: &[f32; JOINTS]) -> [f32; JOINTS] {
        let mut booked = [0.0; JOINTS];
        let joints = moved.iter().zip(&self.band).zip(&mut self.ahead);
        for (((moved, band), ahead), booked) in joints.zip(&mut booked) {
            let now = *ahead + moved;
            *ahead = clamp(now, -band, *band);
            *booked = now - *ahead;
        }
        booked
    }

    /// Sets the dead band by what a count changes of the force at a stiffness \[N/m\].
    fn widen_band(&mut self, pose: &Pose, stiffness: f32) {
        let (none, full) = (FELT_N.0 * FELT_N.0, FELT_N.1 * FELT_N.1);
        let joints = pose.jacobian.iter().zip(&self.count).zip(&mut self.band);
        for ((column, count), band) in joints {
            let per_count = stiffness * count;
            let square = per_count * per_count * dot(column, column);
            *band = BAND * count * clamp((square - none) * (1.0 / (full - none)), 0.0, 1.0);
        }
    }

    /// As much of the force that is wanted \[N\] as the tank pays for, damping while a part of it is missing, and drag while
    /// anything is owed. `velocity`: of the joints.
    pub fn allow(
        &mut self,
        wanted: &Vec3,
        pose: &Pose,
        velocity: &[f32; JOINTS],
        local: &Local,
    ) -> Vec3 {
        let square = dot(wanted, wanted);
        let along = max(local.along, SOFTEST);
        self.widen_band(pose, local.most);
        let speed = pose.velocity(velocity);
        let is_slow = |speed: &Vec3| dot(speed, speed) < RESTS * RESTS;
        self.mean += (speed - self.mean) * (TICK_S / MEAN_S);
        let rests = is_slow(&speed);
        self.credit
            .watch(local.left, local.horizon_s, self.before_n, rests);
        let stored_j = STORED * 0.5 * square / along;
        self.drift(local.drift_m_per_s, stored_j);
        self.leak(stored_j);
        let size = if square > 0.0 {
            libm::sqrtf(square)
        } else {
            0.0
        };
        let share = if size > 0.0 {
            self.share(&(wanted * (1.0 / size)), size, pose, velocity, local)
        } else {
            if local.is_apart {
                self.credit.end();
            }
            1.0
        };
        let mut allowed = *wanted;
        if self.guards.tank {
            allowed *= share;
        }
        let missing = size * (1.0 - share);
        self.withholds = self.guards.tank && missing > NOTICED.0 * size + NOTICED.1;
        if self.guards.credit {
            // A host that tells forces alone says nothing of what a spring has stored.
            let lacks = missing > LACKS.0 * size + LACKS.1 && local.most > SOFTEST;
            // A grip whose force comes and goes with the tank swings around where it rests.
            self.credit
                .lack(lacks, share * size, rests || is_slow(&self.mean));
        }
        if self.guards.damping && share < 1.0 && !self.is_returning() {
            let damping = self.damper(pose, velocity) * (1.0 - share);
            // What lets go of the tool must not hold it.
            let against_n = dot(&damping, wanted) / size;
            let most_n = 0.25 * share * size;
            allowed -= if against_n > most_n {
                damping * (most_n / against_n)
            } else {
                damping
            };
        }
        if self.credit.owed_j() > 0.0 {
            allowed -= speed * self.credit.drag(libm::sqrtf(dot(&speed, &speed)));
        }
        allowed
    }

    /// Part of a force that is wanted, `size` \[N\] in `direction`, that is let through.
    fn share(
        &mut self,
        direction: &Vec3,
        size: f32,
        pose: &Pose,
        velocity: &[f32; JOINTS],
        local: &Local,
    ) -> f32 {
        let stiffness = max(local.most, SOFTEST);
        let forecast = self.forecast(&pose.effort(&(direction * size)), velocity);
        let mut spring_n = self.covered(&forecast, stiffness);
        let speed = dot(direction, &pose.velocity(velocity));
        let returned = if self.is_returning() {
            self.credit.raise(size, speed, stiffness, spring_n)
        } else {
            None
        };
        let bound = match returned {
            Some(level) => {
                let stored_j = 0.5 * level * level / stiffness + CREDIT_J;
                self.energy_j += self.credit.draw(stored_j - self.energy_j);
                spring_n = self.covered(&forecast, stiffness);
                level
            }
            None => max(spring_n, self.built(&forecast, pose, direction, stiffness)),
        };
        let covered = if size > bound { bound / size } else { 1.0 };
        let share = min(covered, self.paid(&forecast)) * self.shrunk();
        // What is all there early in a ramp has not come back before the tank pays for what it is a part of.
        let is_covered = spring_n * local.ramp >= size;
        self.credit.note(size, size * (1.0 - share), is_covered);
        share
    }

    fn is_returning(&self) -> bool {
        self.guards.credit && self.credit.is_open()
    }

    /// Takes note of what went to the motors: efforts of the contact force, and that force \[N\].
    pub fn commit(&mut self, efforts: &[f32; JOINTS], force: &Vec3) {
        let mut newer = *efforts;
        for place in &mut self.efforts {
            newer = core::mem::replace(place, newer);
        }
        self.before_n = libm::sqrtf(dot(force, force));
    }

    /// The amplifiers are off: nothing acts any more. Arming again brings no new credit.
    pub fn off(&mut self) {
        self.efforts = [[0.0; JOINTS]; DELAYED];
        self.before_n = 0.0;
        self.withholds = false;
        self.credit.lose(0.0);
        self.credit.pay(max(self.energy_j - CREDIT_J, 0.0));
        self.drifted_j = 0.0;
        self.energy_j = min(self.energy_j, CREDIT_J);
    }

    /// Books the work of a surface that moves by itself: what it does on its way to the tool is paid, and on its way back it takes that again,
    /// but for what the contact can have stored.
    fn drift(&mut self, speed: f32, stored_j: f32) {
        let work_j = self.before_n * speed * TICK_S;
        let work_j = if work_j < 0.0 {
            let over_j = max(self.energy_j - stored_j, 0.0);
            max(work_j, -min(self.drifted_j, over_j))
        } else {
            work_j
        };
        self.energy_j += work_j;
        self.drifted_j = max(self.drifted_j + work_j, 0.0);
    }

    /// Old dissipation, beyond what the present contact can have stored, does not pay for a swing of now, but pays back
    /// what is owed.
    fn leak(&mut self, stored_j: f32) {
        let owes = self.credit.owed_j() > 0.0;
        let (reserve_j, part) = if owes {
            (CREDIT_J, PAID)
        } else {
            (RESERVE_J, LEAK)
        };
        let over_j = self.energy_j - stored_j - reserve_j;
        if over_j > 0.0 {
            self.energy_j -= over_j * part;
            self.credit.pay(over_j * part);
        }
    }

    /// The joints as the efforts under way and this one would move them if nobody held the grip: the most that a
    /// passive hand lets them have.
    fn forecast(&self, effort: &[f32; JOINTS], velocity: &[f32; JOINTS]) -> Forecast {
        let mut speed = *velocity;
        let mut under_way_j = 0.0;
        for index in (0..=self.whole).rev() {
            let seconds = if index == self.whole {
                self.part * TICK_S
            } else {
                TICK_S
            };
            let acting = self.efforts.get(index).copied().unwrap_or_default();
            for ((speed, inertia), acting) in speed.iter_mut().zip(&self.inertia).zip(acting) {
                let gained = acting * seconds / inertia;
                under_way_j += acting * seconds * (*speed + 0.5 * gained);
                *speed += gained;
            }
        }
        let (mut linear_j, mut quadratic_j, mut squares) = (0.0, 0.0, 0.0);
        let constants = self.inertia.iter().zip(&self.per_step);
        for ((effort, speed), (inertia, per_step)) in effort.iter().zip(&speed).zip(constants) {
            linear_j += effort * TICK_S * speed;
            quadratic_j += 0.5 * effort * TICK_S * (effort * TICK_S / inertia);
            squares += effort * per_step * (effort * per_step);
        }
        // The slew limits take so many more ticks to take the force away, at most, along what it pushes meanwhile.
        let steps = libm::sqrtf(squares);
        quadratic_j += 0.5 * steps * max(linear_j, 0.0) + 0.25 * steps * (steps * quadratic_j);
        Forecast {
            under_way_j,
            linear_j,
            quadratic_j,
        }
    }

    /// Part s of the force, 0 to 1, whose work s linear + s^2 quadratic the tank pays.
    fn paid(&self, forecast: &Forecast) -> f32 {
        let Forecast {
            under_way_j,
            linear_j: a,
            quadratic_j: b,
        } = *forecast;
        let tank_j = self.energy_j;
        let available_j = if tank_j > 0.0 { SHARE * tank_j } else { tank_j } - under_way_j;
        if a + b <= available_j || b <= 0.0 {
            return 1.0;
        }
        let square = max(a * a + 4.0 * b * available_j, 0.0);
        clamp((libm::sqrtf(square) - a) / (2.0 * b), 0.0, 1.0)
    }

    /// Largest force \[N\] that what the tank will hold can have loaded a spring with.
    ///
    /// A contact of stiffness K, symmetric and nowhere softer than it says, that holds a force F stores F'K^-1 F / 2, which is at least F^2 / (2 k)
    /// with the largest eigenvalue k of K: a force beyond (2 k E)^(1/2) has not been paid for, whatever its direction, and
    /// no elastic one that was is ever cut. Of a way dx the force does the work F n . dx: only the part of the way along
    /// it is a way out, or builds it up, and none of a slide across it.
    fn covered(&self, forecast: &Forecast, stiffness: f32) -> f32 {
        let own_j = 0.5 * min(forecast.linear_j, 0.0);
        let tank_j = max(self.energy_j - forecast.under_way_j - own_j, 0.0);
        libm::sqrtf(2.0 * COVER * stiffness * tank_j)
    }

    /// Force \[N\] that was there before, and what the motion since then built up. On the way out what is not covered goes
    /// at the slope of a stiff spring, not at once.
    fn built(&self, forecast: &Forecast, pose: &Pose, direction: &Vec3, stiffness: f32) -> f32 {
        let moved = pose.velocity(&self.moved);
        let (out_m, in_m) = if self.guards.along {
            let along_m = dot(direction, &moved);
            (max(along_m, 0.0), max(-along_m, 0.0))
        } else {
            let way_m = libm::sqrtf(dot(&moved, &moved));
            (way_m, way_m)
        };
        if forecast.linear_j > 0.0 {
            self.before_n - 4.0 * stiffness * out_m
        } else {
            self.before_n + (stiffness + 2.0 * self.grip_damping(pose) / TICK_S) * in_m
        }
    }

    /// Smallest damping of the device along the joints' directions at the grip \[N s/m\].
    fn grip_damping(&self, pose: &Pose) -> f32 {
        let columns = pose.jacobian.iter().zip(&self.damping);
        columns.fold(1e3, |least, (column, damping)| {
            let square = max(dot(column, column), 1e-6);
            min(damping / square, least)
        })
    }

    /// 1, and less the further the tank is overdrawn: no forecast helps against encoders that lie.
    fn shrunk(&self) -> f32 {
        let over = min(self.energy_j / OVERDRAWN_J, 1e3);
        if over > 0.0 {
            1.0 / (1.0 + over * over)
        } else {
            1.0
        }
    }

    /// Largest damping force, to be taken off \[N\]: what it takes from the hand pays for the force that is missing.
    fn damper(&self, pose: &Pose, velocity: &[f32; JOINTS]) -> Vec3 {
        let speed = pose.velocity(velocity);
        let square = dot(&speed, &speed);
        let mobility = pose
            .effort(&speed)
            .iter()
            .zip(&self.inertia)
            .fold(0.0, |sum, (effort, inertia)| {
                sum + effort * (effort / inertia)
            });
        if square < SLOWEST * SLOWEST || mobility <= 0.0 {
            return Vec3::zeros();
        }
        speed * (self.damping_per_s * (square / mobility))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::{Joint, Kinematics};
    use crate::kinematics::forward;

    fn device(actuation_delay_us: u32) -> DeviceDescription {
        let joint = Joint {
            counts_per_unit: 1e5,
            zero_counts: 0,
            effort_per_amp: 1.0,
            max_current_a: 100.0,
            max_slew_per_s: 1e6,
            max_speed_per_s: 10.0,
            inertia: 0.1,
            damping: 0.5,
            coulomb: 0.0,
        };
        DeviceDescription {
            name: [0; 16],
            kinematics: Kinematics::Cartesian { origin_m: [0.0; 3] },
            joints: [joint; JOINTS],
            gravity_mass_kg: [0.0; JOINTS],
            max_force_n: 10.0,
            max_power_w: 5.0,
            max_grip_speed_m_per_s: 2.0,
            actuation_delay_us,
        }
    }

    /// Efforts of 1, 2, 3 .. N at the ticks, and then 1 mm along them in one tick.
    fn booked(delay_us: u32) -> f32 {
        let mut ledger = Passivity::new(&device(delay_us), Guards::ALL);
        for effort in 1..=9_u8 {
            let effort = f32::from(effort);
            ledger.commit(&[effort, 0.0, -effort], &Vec3::new(effort, 0.0, -effort));
        }
        ledger.book(&[1e-3, 5.0, 0.0]);
        (CREDIT_J - ledger.energy_j()) * 1e3
    }

    #[test]
    fn the_work_is_that_of_what_acted() {
        // The last command was 9 N; with a delay of a quarter of a tick 8 N acted for a quarter of it.
        for (delay_us, acted_n) in [
            (0, 9.0),
            (250, 8.75),
            (1000, 8.0),
            (1500, 7.5),
            (4750, 4.25),
            (5000, 4.0),
        ] {
            let found = booked(delay_us);
            assert!((found - acted_n).abs() < 1e-4, "{delay_us}: {found}");
        }
    }

    #[test]
    fn to_and_fro_by_a_count_is_no_work() {
        let mut ledger = Passivity::new(&device(0), Guards::ALL);
        let count = 1e-5;
        ledger.widen_band(&forward(&device(0), &[0.0; JOINTS]), 5e3);
        for tick in 0..100_u8 {
            // More force on the way out than on the way in.
            let (force, way) = if tick % 2 == 0 {
                (2.0, -count)
            } else {
                (3.0, count)
            };
            ledger.commit(&[force, 0.0, 0.0], &Vec3::new(force, 0.0, 0.0));
            ledger.book(&[way, 0.0, 0.0]);
        }
        // One way in at most.
        assert!((0.0..2.0 * count).contains(&(ledger.energy_j - CREDIT_J)));
        // A way is as long as it is, however slow.
        let before_j = ledger.energy_j;
        for _ in 0..100 {
            ledger.book(&[-count, 0.0, 0.0]);
        }
        let in_m = (ledger.energy_j - before_j) / 3.0;
        assert!((in_m - 100.0 * count).abs() <= 1.21 * count, "{in_m}");
    }

    fn allowed(energy_j: f32, wanted: f32, speed: f32, before: f32) -> f32 {
        let device = device(0);
        let mut ledger = Passivity::new(
            &device,
            Guards {
                damping: false,
                credit: false,
                ..Guards::ALL
            },
        );
        let pose = forward(&device, &[0.0; JOINTS]);
        ledger.commit(&[before, 0.0, 0.0], &Vec3::new(before, 0.0, 0.0));
        ledger.energy_j = energy_j;
        let force = ledger.allow(
            &Vec3::new(wanted, 0.0, 0.0),
            &pose,
            &[speed, 0.0, 0.0],
            &Local {
                along: 1000.0,
                most: 1000.0,
                left: 1.0,
                horizon_s: 0.1,
                is_apart: false,
                ramp: 1.0,
                drift_m_per_s: 0.0,
            },
        );
        force.x
    }

    #[test]
    fn what_is_given_is_what_the_tank_pays_for() {
        // A press of 5 mm and 5 N has left 12.5 mJ: let go at 0.2 m/s it keeps its force.
        assert_eq!(allowed(12.5e-3, 5.0, 0.2, 5.0), 5.0);
        // Nothing in the tank: nothing along the motion, and all against it.
        assert_eq!(allowed(0.0, 5.0, 0.2, 5.0), 0.0);
        assert_eq!(allowed(0.0, 5.0, -0.3, 5.0), 5.0);
        // s A + s^2 B = 0.7 E with A = 5 N 0.2 m/s 1 ms and B = (5 N 1 ms)^2 / (2 0.1 kg), and the slew of 1/200 tick:
        // 1.1275 s^2 is 0.125 + 0.0025 mJ.
        let part = allowed(0.5e-3, 5.0, 0.2, 5.0) / 5.0;
        let (a, b) = (
            1e-3,
            0.125e-3 * (1.0 + 0.25 * 0.005 * 0.005) + 0.5 * 0.005 * 1e-3,
        );
        assert!(
            (part * a + part * part * b - 0.35e-3).abs() < 1e-7,
            "{part}"
        );
    }

    #[test]
    fn what_nobody_built_up_must_be_covered() {
        // At rest, from nothing: the spring of 1.5 kN/m that 2 mJ load.
        let force = allowed(2e-3, 9.0, 0.0, 0.0);
        assert!(
            (force - libm::sqrtf(2.0 * 1500.0 * 2e-3)).abs() < 1e-3,
            "{force}"
        );
        // What was there before stays.
        assert_eq!(allowed(2e-3, 5.0, 0.0, 5.0), 5.0);
    }

    /// Beyond what the contact can have stored the tank forgets; below it never.
    #[test]
    fn only_what_is_no_store_leaks() {
        let after = |energy_j: f32| {
            let mut ledger = Passivity::new(&device(0), Guards::ALL);
            ledger.energy_j = energy_j;
            ledger.leak(5e-3 - RESERVE_J);
            ledger.energy_j
        };
        assert_eq!(after(5e-3), 5e-3);
        assert_eq!(after(-1e-3), -1e-3);
        assert!((after(15e-3) - (15e-3 - 10e-3 * TICK_S)).abs() < 1e-8);
    }

    #[test]
    fn arming_again_brings_no_credit() {
        let mut ledger = Passivity::new(&device(0), Guards::ALL);
        ledger.energy_j = -0.4e-3;
        ledger.off();
        assert_eq!(ledger.energy_j(), -0.4e-3);
        ledger.energy_j = 20e-3;
        ledger.off();
        assert_eq!(ledger.energy_j(), CREDIT_J);
    }
}
