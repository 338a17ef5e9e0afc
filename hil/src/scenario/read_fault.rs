//! The `[[fault]]` sections of a scenario file. Entry point: [`Check::fault`].

use super::file::{FaultSection, Number};
use super::read::Check;
use super::{Fault, FaultExpect, FaultKind, FloodWith, Insane, LineFault, Tamper, Ticks, Ways};
use sutura_host::scene::SceneError;
use sutura_shared::wire::validate::MAX_TANGENT;
use toml::Spanned;

impl Check<'_> {
    /// One of them; `end`: the scenario's.
    pub fn fault(&self, section: &Spanned<FaultSection>, end: Ticks) -> Result<Fault, SceneError> {
        let (span, section) = (section.span(), section.get_ref());
        let at = self.before("at_ms", &section.at_ms, end)?;
        let mut kinds = self.line_faults(section)?;
        kinds.extend(self.other_faults(section)?);
        let [kind] = <[FaultKind; 1]>::try_from(kinds).map_err(|kinds| {
            let message = format!(
                "{} kinds of fault in one `[[fault]]`: there must be one",
                kinds.len()
            );
            let help =
                "say one of them, e.g. `loss = { share = 0.3 }`; write a `[[fault]]` for each";
            self.0.flaw(span.clone(), message, "which one?", Some(help))
        })?;
        if let (Some(way), false) = (&section.way, matches!(kind, FaultKind::Line(..))) {
            let help = "loss, bursts, duplicates, reordering, bit_flips, truncation, delay, jitter and stall have one";
            return Err(self.0.flaw(
                way.span(),
                "this fault has no `way`",
                "not here",
                Some(help),
            ));
        }
        let mut until = match &section.for_ms {
            Some(time) => at + self.time("for_ms", time, 0.0)?,
            None => end,
        };
        if let Some(back) = section
            .host_killed
            .as_ref()
            .and_then(|k| k.back_after_ms.as_ref())
        {
            until = at + self.time("back_after_ms", back, 0.0)?;
        }
        let [zero, recovers, reconnects, silent] = self.times([
            ("zero_within_ms", &section.zero_within_ms),
            ("recovers_within_ms", &section.recovers_within_ms),
            ("reconnects_within_ms", &section.reconnects_within_ms),
            ("silent_within_ms", &section.silent_within_ms),
        ])?;
        let lasts = until.min(end) - at;
        let shown = [
            ("zero_within_ms", &section.zero_within_ms, zero),
            ("silent_within_ms", &section.silent_within_ms, silent),
        ];
        for (key, value, limit) in shown {
            if let (Some(value), true) = (value, limit.is_some_and(|limit| limit >= lasts)) {
                let message = format!(
                    "{key} = {}: the fault lasts {lasts} ms only",
                    value.get_ref()
                );
                let help = "let the fault last longer, or expect it sooner";
                return Err(self.0.flaw(value.span(), message, "never seen", Some(help)));
            }
        }
        let holds_n = section.holds_n.as_ref();
        let holds_n = holds_n.map(|n| self.within("holds_n", n, 0.0, 1e3, "N"));
        Ok(Fault {
            at,
            until: until.min(end),
            kind,
            expect: FaultExpect {
                zero,
                recovers,
                reconnects,
                silent,
                holds_n: holds_n.transpose()?,
            },
        })
    }

    fn line_faults(&self, section: &FaultSection) -> Result<Vec<FaultKind>, SceneError> {
        let both = Ways {
            down: true,
            up: true,
        };
        let known = [
            ("down", Ways { up: false, ..both }),
            (
                "up",
                Ways {
                    down: false,
                    ..both
                },
            ),
            ("both", both),
        ];
        let ways = match &section.way {
            Some(way) => self.word("way", way, &known)?,
            None => known[0].1,
        };
        let mut kinds = Vec::new();
        let mut add = |fault| kinds.push(FaultKind::Line(ways, fault));
        if let Some(s) = &section.loss {
            add(LineFault::Loss(self.share(&s.share)?));
        }
        if let Some(s) = &section.bursts {
            let lost = self.time("lost_ms", &s.lost_ms, 1.0)?;
            let every = self.time("every_ms", &s.every_ms, 1.0)?;
            add(LineFault::Bursts(lost, every));
        }
        if let Some(s) = &section.duplicates {
            let [after] = self.times([("after_ms", &s.after_ms)])?;
            add(LineFault::Duplicates(
                self.share(&s.share)?,
                after.unwrap_or(0),
            ));
        }
        if let Some(s) = &section.reordering {
            let by = self.time("by_ms", &s.by_ms, 1.0)?;
            add(LineFault::Reordering(self.share(&s.share)?, by));
        }
        if let Some(s) = &section.bit_flips {
            let bits = match &s.bits {
                Some(bits) => self.within("bits", bits, 1.0, 1000.0, "")? as u32,
                None => 1,
            };
            add(LineFault::BitFlips(self.share(&s.share)?, bits));
        }
        if let Some(s) = &section.truncation {
            add(LineFault::Truncation(self.share(&s.share)?));
        }
        if let Some(s) = &section.delay {
            add(LineFault::Delay(self.time("ms", &s.ms, 0.0)?));
        }
        if let Some(s) = &section.jitter {
            add(LineFault::Jitter(self.time("ms", &s.ms, 0.0)?));
        }
        if section.stall.is_some() {
            add(LineFault::Stall);
        }
        if section.cable_pulled.is_some() {
            kinds.push(FaultKind::Line(both, LineFault::Pulled));
        }
        Ok(kinds)
    }

    fn other_faults(&self, section: &FaultSection) -> Result<Vec<FaultKind>, SceneError> {
        let mut kinds = Vec::new();
        if let Some(s) = &section.solver_wedged {
            let known = [("stop", false), ("repeat", true)];
            let repeats = self.word("way to be wedged", &s.contacts, &known)?;
            kinds.push(FaultKind::Tamper(Tamper::Wedged { repeats }));
        }
        if let Some(s) = &section.wrong_clock {
            let number = |key, value: &Option<Number>, unit| match value {
                Some(value) => self.within(key, value, -1e6, 1e6, unit),
                None => Ok(0.0),
            };
            kinds.push(FaultKind::Tamper(Tamper::Clock {
                offset_us: 1e3 * number("offset_ms", &s.offset_ms, "ms")?,
                drift_ppm: number("drift_ppm", &s.drift_ppm, "ppm")?,
            }));
        }
        if let Some(s) = &section.insane {
            let known = [
                ("tangent", (Insane::Tangent, f64::from(MAX_TANGENT))),
                ("force", (Insane::Force, 1e4)),
                ("shaking", (Insane::Shaking, 1e4)),
                ("horizon", (Insane::Horizon, f64::from(u32::MAX))),
                ("not_finite", (Insane::NotFinite, f64::NAN)),
            ];
            let (what, default) = self.word("insane value", &s.what, &known)?;
            let value = match &s.value {
                Some(value) => self.within("value", value, -1e12, 1e12, "")?,
                None => default,
            };
            let share = s
                .share
                .as_ref()
                .map(|share| self.share(share))
                .transpose()?;
            let share = share.unwrap_or(1.0);
            kinds.push(FaultKind::Tamper(Tamper::Insane { what, value, share }));
        }
        if let Some(s) = &section.replay {
            let rate = self.within("frames_per_ms", &s.frames_per_ms, 0.001, 100.0, "")?;
            kinds.push(FaultKind::Replay(rate));
        }
        if let Some(s) = &section.flood {
            let known = [
                ("garbage", FloodWith::Garbage),
                ("contacts", FloodWith::Contacts),
                ("hellos", FloodWith::Hellos),
            ];
            let with = self.word("flood", &s.with, &known)?;
            let bytes = self.within("bytes_per_ms", &s.bytes_per_ms, 1.0, 4000.0, "bytes/ms")?;
            kinds.push(FaultKind::Flood(with, bytes as usize));
        }
        if let Some(s) = &section.second_host {
            kinds.push(FaultKind::SecondHost {
                every: self.time("every_ms", &s.every_ms, 1.0)?,
                wrong_schema: s.wrong_schema,
            });
        }
        if let Some(s) = &section.host_killed {
            let back = s.back_after_ms.as_ref().map(|_| s.arms);
            kinds.push(FaultKind::HostKilled { back });
        }
        if section.console_reset.is_some() {
            kinds.push(FaultKind::ConsoleReset);
        }
        if section.emergency_stop.is_some() {
            kinds.push(FaultKind::EmergencyStop);
        }
        if let Some(s) = &section.encoder_jump {
            kinds.push(FaultKind::EncoderJump(*s.counts.get_ref()));
        }
        if let Some(s) = &section.encoder_burst {
            kinds.push(FaultKind::EncoderBurst(*s.counts.get_ref()));
        }
        Ok(kinds)
    }
}
