//! Rate at which the force on a held tool relaxes where the tissue's stress does.
//!
//! Entry point: [`Fading::rate_per_s`]. Stress that fades alike everywhere leaves places alone: the force on a tool is the elastic one with
//! the relaxation function convolved (Christensen 1982, 2.1), and what has not faded yet follows from the forces themselves.

use nalgebra::Vector3;

/// One term of the relaxation function, and the force on a tool as far as it has one.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fading {
    /// Part of the stress that fades, 0 to 1, and the time in which it does \[s\].
    share: f64,
    time_s: f64,
    /// Force that would act if nothing faded, and what of it has not faded yet \[N\].
    elastic: Vector3<f64>,
    unfaded: Vector3<f64>,
}

impl Fading {
    /// Nothing is touched yet.
    pub fn new((share, time_s): (f64, f64)) -> Self {
        Self {
            share,
            time_s,
            elastic: Vector3::zeros(),
            unfaded: Vector3::zeros(),
        }
    }

    /// Rate at which a force \[N\] that has been reached in `step_s` fades along itself at a held pose \[1/s\], 0 or more. Between two
    /// steps the elastic force is taken to change evenly; a force of zero begins anew.
    pub fn rate_per_s(&mut self, force: &Vector3<f64>, step_s: f64) -> f64 {
        if force.norm_squared() == 0.0 || step_s <= 0.0 {
            (self.elastic, self.unfaded) = (Vector3::zeros(), Vector3::zeros());
            return 0.0;
        }
        // F = (1 - g) E + Q with Q' = g E' - Q / tau (Simo and Hughes 1998, 10.3.1, with E' constant in the step).
        let kept = (-step_s / self.time_s).exp();
        let gained = self.share * (1.0 - kept) * self.time_s / step_s;
        let elastic =
            (force - self.unfaded * kept + self.elastic * gained) / (1.0 - self.share + gained);
        self.unfaded = self.unfaded * kept + (elastic - self.elastic) * gained;
        self.elastic = elastic;
        (self.unfaded.dot(force) / force.norm_squared() / self.time_s).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Document, Pose, read};
    use crate::script::at_rest;
    use crate::session::SceneSolver;
    use crate::step::Status;

    /// A ball is pressed 4 mm into a slab in 0.1 s and held there: the rate is that at which the force falls, and goes down as the stress
    /// fades to the half that stays.
    #[test]
    fn the_rate_is_that_of_a_held_ball() {
        let text = r#"
            name = "slab"
            [mesh.slab]
            size_m = [0.08, 0.08, 0.03]
            divisions = [8, 8, 3]
            [tissue]
            model = "energy-balance-neo-hookean"
            youngs_modulus_pa = 15e3
            poisson_ratio = 0.45
            relaxation = { share = 0.5, time_s = 0.3 }
            [[fixed]]
            plane = { axis = "z", at_m = -0.03 }
            [[tool]]
            driven = true
            radius_m = 0.014
        "#;
        let scene = read(&Document::embedded("slab.toml", "".as_ref(), text)).expect("a scene");
        let mut solver = SceneSolver::new(&scene).expect("a solver");
        const STEP_S: f64 = 5e-3;
        let mut steps = Vec::new();
        for step in 0..=300_u32 {
            let t = f64::from(step) * STEP_S;
            let depth_m = 0.006 * (t / 0.1).min(1.0) - 0.002;
            let mut sample = at_rest(
                0,
                &Pose {
                    position_m: [0.0, 0.0, 0.014 - depth_m],
                    orientation: [0.0, 0.0, 0.0, 1.0],
                },
            );
            sample.console_time_us = u64::from(step) * 5000;
            let report = solver.step(sample);
            assert_eq!(report.status, Status::Ok, "{t} s");
            let contact = report.contacts()[0];
            steps.push((contact.wrench[2], contact.relaxation_per_s));
        }
        assert_eq!(steps[2].1, 0.0, "in the air");
        for at in [40, 60, 100, 200] {
            let [(before, _), (force, rate), (after, _)] =
                [steps[at - 5], steps[at], steps[at + 5]];
            let falls = (before - after) / (10.0 * STEP_S) / force;
            assert!(
                (rate - falls).abs() < 0.05 * falls + 0.01,
                "{at}: {rate}, falls by {falls}"
            );
        }
        let (last, rate) = steps[300];
        assert!(rate < 0.05 && last < 0.62 * steps[21].0, "{last} N, {rate}");
    }

    /// Pressed evenly in 0.1 s and held: the rate is that of the closed form, F = E ((1 - g) + g tau (1 - e^(-T/tau)) / T e^(-t/tau)).
    #[test]
    fn the_rate_is_that_of_a_ramp_and_a_hold() {
        for (share, time_s, step_s) in [(0.5, 0.58, 5e-3), (0.9, 0.05, 2e-3), (0.2, 3.0, 0.02)] {
            let mut fading = Fading::new((share, time_s));
            let ramp_s = 0.1;
            let unfaded = |t: f64| {
                let risen = t.min(ramp_s);
                share * time_s / ramp_s
                    * (1.0 - (-risen / time_s).exp())
                    * (-(t - risen) / time_s).exp()
            };
            let force = |t: f64| (1.0 - share) * t.min(ramp_s) / ramp_s + unfaded(t);
            let steps = (1.0 / step_s) as u32;
            for step in 1..=steps {
                let t = f64::from(step) * step_s;
                let along = Vector3::new(0.6, 0.0, 0.8);
                let rate = fading.rate_per_s(&(along * force(t)), step_s);
                let truth = unfaded(t) / force(t) / time_s;
                assert!(
                    (rate - truth).abs() < 1e-9 / time_s,
                    "{t} s: {rate}, not {truth}"
                );
            }
            assert_eq!(fading.rate_per_s(&Vector3::zeros(), step_s), 0.0);
            assert_eq!(fading.unfaded, Vector3::zeros());
        }
    }
}
