//! Servo amplifiers that read their set points from pulses, with one enable and one ready line for all of them.
//!
//! Entry points, once a tick each: [`Amplifiers::take_currents`] where the tick reads, [`Amplifiers::drive`] where it writes.
//!
//! To start: pulses for no current for 20 ms, enable, and currents once they are ready. An amplifier that is enabled first
//! finds no pulses, which it takes for a fault or for full current backwards. To stop: enable off and no current at once; the
//! pulses go on for 20 ms, because an amplifier's enable input may take 8 ms to act, in which no pulses would be a set point.
//!
//! How long they may take to get ready is the control loop's business: `sutura_shared::control`.

use crate::signals::SetPoint;
use embedded_hal::digital::{InputPin, OutputPin};
use embedded_hal::pwm::SetDutyCycle;
use sutura_shared::mutant::stands;

/// Pulses for no current before the amplifiers are enabled, and after \[ticks of 1 ms\]: twice the slowest enable input known,
/// 8 ms, and a few pulses of the slowest usual frequency.
const PULSES_ALONE: u8 = 20;

/// A pin or a timer did not do what it was told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotObeyed;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// No pulses, no enable.
    Off,
    /// Pulses for no current, for so many ticks more.
    Starting(u8),
    /// Enabled.
    On,
    /// Pulses for no current, for so many ticks more.
    Stopping(u8),
}

/// The amplifiers of `N` motors.
///
/// `P`: the pulses of a motor; `O`: the switch of all pulses; `E`: enable; `R`: ready. Lines of the other polarity are turned
/// round by the board's pins.
#[derive(Debug)]
pub struct Amplifiers<P, O, E, R, const N: usize> {
    pulses: [P; N],
    outputs: O,
    enable: E,
    ready: R,
    set_point: SetPoint,
    phase: Phase,
    /// What [`Self::take_currents`] found last.
    took: bool,
}

impl<P, O, E, R, const N: usize> Amplifiers<P, O, E, R, N>
where
    P: SetDutyCycle,
    O: OutputPin,
    E: OutputPin,
    R: InputPin,
{
    /// Amplifiers that nobody has started. Whatever they were before, `drive(None)` makes sure of it.
    pub fn new(pulses: [P; N], outputs: O, enable: E, ready: R, set_point: SetPoint) -> Self {
        Self {
            pulses,
            outputs,
            enable,
            ready,
            set_point,
            phase: Phase::Off,
            took: false,
        }
    }

    /// Whether they take currents in this tick: they have been started and say that they are ready. A line that cannot be
    /// read is not ready.
    pub fn take_currents(&mut self) -> bool {
        let ready = self.ready.is_high().unwrap_or(false);
        self.took = self.phase == Phase::On && ready;
        self.took
    }

    /// Whether they are enabled.
    pub fn are_enabled(&self) -> bool {
        self.phase == Phase::On
    }

    /// Whether they have been stopped, and pulses with them.
    pub fn are_off(&self) -> bool {
        self.phase == Phase::Off
    }

    /// Whether they have been asked for. Not from the stop on, while the last pulses run: enable is low, and their supply may go.
    pub fn are_wanted(&self) -> bool {
        matches!(self.phase, Phase::Starting(_) | Phase::On)
    }

    /// One tick: currents \[A\] to go to the motors, or `None` to stop. While they do not take currents none goes out.
    ///
    /// # Errors
    /// [`NotObeyed`] if a pin or timer refused: then they are being stopped, as far as the others obey. The next tick begins
    /// again with what it is asked for.
    pub fn drive(&mut self, current_a: Option<&[f32; N]>) -> Result<(), NotObeyed> {
        match current_a {
            None => self.stop(),
            Some(current_a) => self.start(current_a).or_else(|refused| {
                self.stop()?;
                Err(refused)
            }),
        }
    }

    fn start(&mut self, current_a: &[f32; N]) -> Result<(), NotObeyed> {
        match self.phase {
            Phase::Off | Phase::Stopping(_) => {
                self.set(&[0.0; N])?;
                self.outputs.set_high().map_err(|_| NotObeyed)?;
                self.phase = Phase::Starting(PULSES_ALONE);
            }
            Phase::Starting(left @ 2..) if stands("pulses_first") => {
                self.phase = Phase::Starting(left - 1)
            }
            Phase::Starting(_) => {
                self.enable.set_high().map_err(|_| NotObeyed)?;
                self.phase = Phase::On;
            }
            Phase::On if self.took || !stands("ready_first") => self.set(current_a)?,
            Phase::On => self.set(&[0.0; N])?,
        }
        Ok(())
    }

    /// Every line is written in every tick, not only in the first, and whatever the others do.
    fn stop(&mut self) -> Result<(), NotObeyed> {
        self.phase = match self.phase {
            Phase::Off | Phase::Stopping(..=1) => Phase::Off,
            Phase::Stopping(left) if stands("pulses_last") => Phase::Stopping(left - 1),
            Phase::Stopping(_) => Phase::Off,
            Phase::Starting(_) | Phase::On => Phase::Stopping(PULSES_ALONE),
        };
        if !stands("enable_first") {
            self.set(&[0.0; N])?;
        }
        // Enable first: it alone means no torque.
        let enable = self.enable.set_low().map_err(|_| NotObeyed);
        let current = self.set(&[0.0; N]);
        // As long as an amplifier may be enabled, pulses of no current are better than none.
        let outputs = if self.phase == Phase::Off && enable.is_ok() {
            self.outputs.set_low().map_err(|_| NotObeyed)
        } else {
            Ok(())
        };
        enable.and(current).and(outputs)
    }

    /// Sets every motor's pulses, also when one refuses.
    fn set(&mut self, current_a: &[f32; N]) -> Result<(), NotObeyed> {
        let set_point = self.set_point;
        let mut result = Ok(());
        for (pulses, &current_a) in self.pulses.iter_mut().zip(current_a) {
            let duty = set_point.duty(current_a, pulses.max_duty_cycle());
            let set = pulses.set_duty_cycle(duty).map_err(|_| NotObeyed);
            result = result.and(set);
        }
        result
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use embedded_hal::digital;
    use embedded_hal::pwm;
    use embedded_hal_mock::eh1::MockError;
    use embedded_hal_mock::eh1::digital::{
        Mock as PinMock, State as Level, Transaction as PinCall,
    };
    use embedded_hal_mock::eh1::pwm::{Mock as PulseMock, Transaction as PulseCall};
    use std::cell::RefCell;
    use std::io::ErrorKind;
    use std::rc::Rc;
    use std::vec::Vec;

    const PERIOD: u16 = 42_000;
    const NONE: u16 = 21_000;
    const SET_POINT: SetPoint = SetPoint::escon(5.0);

    /// A call, in the order in which calls came.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    enum Call {
        Enable(bool),
        Outputs(bool),
        Duty(usize, u16),
    }

    /// The lines of one board: what was called, what stands, and whether an amplifier was ever treated as it must not be.
    #[derive(Debug)]
    struct Lines {
        calls: Vec<Call>,
        enable: bool,
        outputs: bool,
        duty: [u16; 2],
        ready: bool,
        /// Which of enable, outputs, duty 0, duty 1 does not obey.
        stuck: [bool; 4],
        /// Enabled by the driver while pulses were off or commanded a current.
        woken_wrong: bool,
    }

    type Shared = Rc<RefCell<Lines>>;
    struct Enable(Shared);
    struct Outputs(Shared);
    struct Pulses(Shared, usize);
    struct Ready(Shared);

    impl digital::ErrorType for Enable {
        type Error = digital::ErrorKind;
    }
    impl digital::ErrorType for Outputs {
        type Error = digital::ErrorKind;
    }
    impl digital::ErrorType for Ready {
        type Error = digital::ErrorKind;
    }
    impl pwm::ErrorType for Pulses {
        type Error = pwm::ErrorKind;
    }

    fn switch(lines: &Shared, high: bool, line: usize) -> Result<(), digital::ErrorKind> {
        let mut lines = lines.borrow_mut();
        if lines.stuck[line] {
            return Err(digital::ErrorKind::Other);
        }
        if line == 0 {
            let wakes = high && !lines.enable;
            lines.woken_wrong |= wakes && !(lines.outputs && lines.duty == [NONE; 2]);
            lines.enable = high;
            lines.calls.push(Call::Enable(high));
        } else {
            lines.outputs = high;
            lines.calls.push(Call::Outputs(high));
        }
        Ok(())
    }

    impl OutputPin for Enable {
        fn set_low(&mut self) -> Result<(), Self::Error> {
            switch(&self.0, false, 0)
        }
        fn set_high(&mut self) -> Result<(), Self::Error> {
            switch(&self.0, true, 0)
        }
    }
    impl OutputPin for Outputs {
        fn set_low(&mut self) -> Result<(), Self::Error> {
            switch(&self.0, false, 1)
        }
        fn set_high(&mut self) -> Result<(), Self::Error> {
            switch(&self.0, true, 1)
        }
    }
    impl InputPin for Ready {
        fn is_high(&mut self) -> Result<bool, Self::Error> {
            Ok(self.0.borrow().ready)
        }
        fn is_low(&mut self) -> Result<bool, Self::Error> {
            Ok(!self.0.borrow().ready)
        }
    }
    impl SetDutyCycle for Pulses {
        fn max_duty_cycle(&self) -> u16 {
            PERIOD
        }
        fn set_duty_cycle(&mut self, duty: u16) -> Result<(), Self::Error> {
            let mut lines = self.0.borrow_mut();
            if lines.stuck[2 + self.1] {
                return Err(pwm::ErrorKind::Other);
            }
            lines.duty[self.1] = duty;
            lines.calls.push(Call::Duty(self.1, duty));
            Ok(())
        }
    }

    type Bench = Amplifiers<Pulses, Outputs, Enable, Ready, 2>;

    fn bench() -> (Shared, Bench) {
        let lines = Rc::new(RefCell::new(Lines {
            calls: Vec::new(),
            // As whoever had the board before left them.
            enable: true,
            outputs: true,
            duty: [37_800; 2],
            ready: false,
            stuck: [false; 4],
            woken_wrong: false,
        }));
        let to = || Rc::clone(&lines);
        let pulses = [Pulses(to(), 0), Pulses(to(), 1)];
        let mut bench =
            Amplifiers::new(pulses, Outputs(to()), Enable(to()), Ready(to()), SET_POINT);
        bench.drive(None).expect("lines that obey");
        (lines, bench)
    }

    /// One tick with a current for both motors, or none; returns what was called.
    fn tick(lines: &Shared, bench: &mut Bench, current_a: Option<f32>) -> Vec<Call> {
        lines.borrow_mut().calls.clear();
        bench.take_currents();
        let current_a = current_a.map(|current_a| [current_a, -current_a]);
        bench.drive(current_a.as_ref()).expect("lines that obey");
        lines.borrow().calls.clone()
    }

    #[test]
    fn the_first_stop_ends_what_was_on() {
        let (lines, _) = bench();
        use Call::{Duty, Enable, Outputs};
        assert_eq!(
            lines.borrow().calls,
            [Enable(false), Duty(0, NONE), Duty(1, NONE), Outputs(false)]
        );
    }

    #[test]
    fn pulses_of_no_current_for_20_ms_then_enable_then_ready_then_currents() {
        use Call::{Duty, Enable, Outputs};
        let (lines, mut bench) = bench();
        assert!(!bench.are_wanted());
        assert_eq!(
            tick(&lines, &mut bench, Some(5.0)),
            [Duty(0, NONE), Duty(1, NONE), Outputs(true)]
        );
        assert!(bench.are_wanted());
        for _ in 1..20 {
            assert_eq!(tick(&lines, &mut bench, Some(5.0)), []);
            assert!(!bench.are_enabled());
        }
        assert_eq!(tick(&lines, &mut bench, Some(5.0)), [Enable(true)]);
        // Enabled and not ready yet: pulses for no current.
        for _ in 0..300 {
            let calls = tick(&lines, &mut bench, Some(5.0));
            assert_eq!(calls, [Duty(0, NONE), Duty(1, NONE)]);
        }
        lines.borrow_mut().ready = true;
        // 90 % and 10 % of 42000.
        let calls = tick(&lines, &mut bench, Some(5.0));
        assert_eq!(calls, [Duty(0, 37_800), Duty(1, 4_200)]);
        assert!(bench.took);
        // Ready is lost: no current in the same tick, whatever is asked for.
        lines.borrow_mut().ready = false;
        let calls = tick(&lines, &mut bench, Some(5.0));
        assert_eq!(calls, [Duty(0, NONE), Duty(1, NONE)]);
        assert!(!bench.took);
    }

    #[test]
    fn enable_and_currents_go_at_once_and_pulses_after_20_ms() {
        use Call::{Duty, Enable, Outputs};
        let (lines, mut bench) = bench();
        lines.borrow_mut().ready = true;
        for _ in 0..30 {
            tick(&lines, &mut bench, Some(1.0));
        }
        let off = [Enable(false), Duty(0, NONE), Duty(1, NONE)];
        assert!(bench.are_wanted());
        for _ in 0..20 {
            assert_eq!(tick(&lines, &mut bench, None), off);
            assert!(lines.borrow().outputs && !bench.are_off());
            assert!(!bench.are_wanted(), "its supply may go");
        }
        for _ in 0..5 {
            let calls = tick(&lines, &mut bench, None);
            assert_eq!(calls[..3], off);
            assert_eq!(calls[3..], [Outputs(false)]);
            assert!(bench.are_off());
        }
    }

    /// Any order of asking and not asking, with a ready line that comes and goes: enabled only after 20 ms of pulses for no
    /// current, which go on for 20 ms after.
    #[test]
    fn no_amplifier_ever_wakes_or_falls_asleep_without_pulses_of_no_current() {
        let mut random = 1_u32;
        let (lines, mut bench) = bench();
        let (mut alone, mut since_enabled, mut woken) = (0, 1000, 0);
        let mut wanted = false;
        for _ in 0..200_000 {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            // Asked for about 30 ticks at a time, so that every phase is left early, too.
            wanted ^= (random >> 24).is_multiple_of(32);
            lines.borrow_mut().ready = random >> 16 & 1 == 1;
            let before = lines.borrow().enable;
            tick(&lines, &mut bench, wanted.then_some(3.0));
            let lines = lines.borrow();
            assert!(!lines.woken_wrong);
            let quiet = lines.outputs && lines.duty == [NONE; 2];
            if lines.enable {
                assert!(before || alone >= 20, "woken after {alone} ms of pulses");
                woken += u32::from(!before);
                since_enabled = 0;
            } else {
                since_enabled += 1;
                assert!(since_enabled > 20 || quiet, "{since_enabled} ms after");
            }
            alone = if quiet && !lines.enable { alone + 1 } else { 0 };
        }
        assert!(woken > 500, "{woken}");
    }

    /// Each line stuck from some tick on, while starting and when on.
    #[test]
    fn a_line_that_does_not_obey_stops_all_the_others_and_says_so() {
        for (stuck, at) in [(0, 5), (1, 0), (2, 0), (3, 0), (2, 25), (3, 25)] {
            let (lines, mut bench) = bench();
            lines.borrow_mut().ready = true;
            for _ in 0..at {
                tick(&lines, &mut bench, Some(2.0));
            }
            lines.borrow_mut().stuck[stuck] = true;
            let mut refused = 0;
            for _ in 0..50 {
                refused += u32::from(bench.drive(Some(&[2.0, 2.0])).is_err());
                assert!(refused == 0 || !bench.take_currents());
                let lines = lines.borrow();
                assert!(refused == 0 || !lines.enable, "line {stuck} from {at}");
                let stopped = |motor| stuck == 2 + motor || lines.duty[motor] == NONE;
                assert!(refused == 0 || (0..2).all(stopped));
            }
            assert!(refused > 0, "line {stuck} from {at}");
        }
    }

    /// The worst line to be stuck: there is no torque all the same, pulses go on, and it is tried in every tick.
    #[test]
    fn an_enable_line_that_stays_up_leaves_pulses_of_no_current() {
        let (lines, mut bench) = bench();
        lines.borrow_mut().ready = true;
        for _ in 0..30 {
            tick(&lines, &mut bench, Some(2.0));
        }
        lines.borrow_mut().stuck[0] = true;
        for _ in 0..100 {
            assert_eq!(bench.drive(None), Err(NotObeyed));
            let lines = lines.borrow();
            assert!(lines.enable && lines.outputs && lines.duty == [NONE; 2]);
        }
        lines.borrow_mut().stuck[0] = false;
        bench.drive(None).expect("lines that obey");
        assert!(!lines.borrow().enable);
    }

    /// The mocks of others: no call but these, errors of their own.
    #[test]
    fn a_ready_line_that_cannot_be_read_is_not_ready() {
        let error = || MockError::Io(ErrorKind::Other);
        let mut ready = PinMock::new(&[
            PinCall::get(Level::High),
            PinCall::get(Level::High).with_error(error()),
        ]);
        let mut enable = PinMock::new(&[PinCall::set(Level::Low), PinCall::set(Level::High)]);
        let mut outputs = PinMock::new(&[PinCall::set(Level::Low), PinCall::set(Level::High)]);
        let set = [
            PulseCall::max_duty_cycle(1000),
            PulseCall::set_duty_cycle(500),
        ];
        // The first stop, then the first tick of starting.
        let mut pulses = PulseMock::new(&[set.clone(), set].concat());
        let mut amplifiers = Amplifiers::new(
            [pulses.clone()],
            outputs.clone(),
            enable.clone(),
            ready.clone(),
            SET_POINT,
        );
        amplifiers.drive(None).expect("mocks that obey");
        for _ in 0..=20 {
            amplifiers.drive(Some(&[1.0])).expect("mocks that obey");
        }
        assert!(amplifiers.take_currents());
        assert!(!amplifiers.take_currents(), "an error on the line");
        ready.done();
        enable.done();
        outputs.done();
        pulses.done();
    }

    #[test]
    fn the_first_stop_reports_a_line_that_does_not_obey() {
        let error = || MockError::Io(ErrorKind::Other);
        let mut enable = PinMock::new(&[PinCall::set(Level::Low).with_error(error())]);
        // Pulses go on for as long as the amplifiers may be enabled.
        let mut outputs = PinMock::new(&[]);
        let mut ready = PinMock::new(&[]);
        let mut pulses = PulseMock::new(&[
            PulseCall::max_duty_cycle(1000),
            PulseCall::set_duty_cycle(500),
        ]);
        let mut amplifiers = Amplifiers::new(
            [pulses.clone()],
            outputs.clone(),
            enable.clone(),
            ready.clone(),
            SET_POINT,
        );
        assert_eq!(amplifiers.drive(None), Err(NotObeyed));
        enable.done();
        outputs.done();
        ready.done();
        pulses.done();
    }
}
