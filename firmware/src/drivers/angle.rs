//! Magnetic angle sensors of the AS5047 family over SPI (mode 1, up to 10 MHz), as the encoder of a joint.
//!
//! Entry points: [`AngleSensor::read`] for one angle with all that the sensor says of itself, [`AngleEncoder::tick`] for counts that
//! do not wrap, once a tick. Frames are of 16 bits, high byte first, with chip select high between two; what a frame asks for is
//! answered in the next one (ams AS5047D data sheet, 7.3). A tick asks for the angle, then for the diagnostics, and so gets
//! the diagnostics of the tick before and the angle of this one, with two frames and nothing left over.

use embedded_hal::spi::SpiDevice;

/// Bits of a frame that are no data: even parity over all of it, and reading in a command; in an answer an error of the frame before.
const PARITY: u16 = 1 << 15;
const READ: u16 = 1 << 14;
const ERROR: u16 = 1 << 14;
const DATA: u16 = 0x3FFF;

/// Error flags, which reading clears; diagnostics; angle with the dynamic error taken out (data sheet, 7.4).
const ERRFL: u16 = 0x0001;
const DIAAGC: u16 = 0x3FFC;
const ANGLECOM: u16 = 0x3FFF;
/// Diagnostics: the field is too low, too high; CORDIC overflow; the sensor has started, which is set whenever one is there.
const MAGL: u16 = 1 << 11;
const MAGH: u16 = 1 << 10;
const COF: u16 = 1 << 9;
const LF: u16 = 1 << 8;

/// Counts of a turn.
const TURN: i32 = 1 << 14;
/// Bad readings in a row that are bridged with the last good one; one more is a broken sensor.
const BRIDGED: u8 = 2;

/// Why there is no angle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AngleFault {
    /// The bus refused.
    Bus,
    /// Nobody drives the line to the controller, or it is shorted: all ones or all zeros.
    Stuck,
    /// The answer's parity is wrong.
    Parity,
    /// The sensor says that the frame before was wrong: its flags, bit 0 = framing, 1 = invalid command, 2 = parity. They are cleared.
    Refused {
        /// Register ERRFL.
        flags: u16,
    },
    /// The magnet is missing, too near or too far, or the sensor's computation overflowed: bits of its register DIAAGC.
    Magnet {
        /// Register DIAAGC.
        diagnostics: u16,
    },
    /// It moved further than the joint can.
    Jump,
}

/// A frame that reads a register.
const fn command(register: u16) -> u16 {
    let frame = READ | register;
    if frame.count_ones() % 2 == 1 {
        frame | PARITY
    } else {
        frame
    }
}

/// A sensor on a bus of its own, or of all.
#[derive(Debug)]
pub struct AngleSensor<S> {
    bus: S,
    /// The last frame asked for the diagnostics.
    primed: bool,
}

impl<S: SpiDevice> AngleSensor<S> {
    /// A sensor that nobody has asked anything.
    pub fn new(bus: S) -> Self {
        Self { bus, primed: false }
    }

    /// The angle now \[1/16384 turn\].
    ///
    /// # Errors
    /// [`AngleFault`], but [`AngleFault::Jump`]. The next reading begins anew.
    pub fn read(&mut self) -> Result<u16, AngleFault> {
        let angle = self.read_primed();
        self.primed = angle.is_ok();
        angle
    }

    fn read_primed(&mut self) -> Result<u16, AngleFault> {
        if !self.primed {
            // Whatever it was last asked for; an error before our time is cleared, too.
            self.exchange(ERRFL)?;
            self.exchange(DIAAGC)?;
        }
        let diagnostics = self.exchange(ANGLECOM)?;
        let angle = self.exchange(DIAAGC)?;
        let diagnostics = self.checked(diagnostics)?;
        // An angle of 0 is a frame of zeros; diagnostics never are.
        if diagnostics == 0 {
            return Err(AngleFault::Stuck);
        }
        if diagnostics & (MAGL | MAGH | COF) != 0 || diagnostics & LF == 0 {
            return Err(AngleFault::Magnet { diagnostics });
        }
        self.checked(angle)
    }

    /// Data of an answer.
    fn checked(&mut self, answer: u16) -> Result<u16, AngleFault> {
        if answer == u16::MAX {
            return Err(AngleFault::Stuck);
        }
        if answer.count_ones() % 2 == 1 {
            return Err(AngleFault::Parity);
        }
        if answer & ERROR != 0 {
            self.exchange(ERRFL)?;
            let flags = self.exchange(DIAAGC)? & DATA;
            return Err(AngleFault::Refused { flags });
        }
        Ok(answer & DATA)
    }

    /// One frame; what comes back answers the one before.
    fn exchange(&mut self, register: u16) -> Result<u16, AngleFault> {
        let mut bytes = command(register).to_be_bytes();
        self.bus
            .transfer_in_place(&mut bytes)
            .map_err(|_| AngleFault::Bus)?;
        Ok(u16::from_be_bytes(bytes))
    }
}

/// What a joint's sensor says in a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Angle {
    /// Counts since the first reading, and that (wrapping).
    pub counts: i32,
    /// Three readings in a row were bad: the counts stand, and are not to be believed.
    pub broken: bool,
    /// Why this tick's reading was bad.
    pub fault: Option<AngleFault>,
}

/// The encoder of a joint: an angle that goes on beyond a turn.
#[derive(Debug)]
pub struct AngleEncoder<S> {
    sensor: AngleSensor<S>,
    /// Most counts in a tick; below half of a turn.
    most: i32,
    counts: Option<i32>,
    bad: u8,
}

impl<S: SpiDevice> AngleEncoder<S> {
    /// `most_per_tick`: counts that the joint can move in a tick, from its largest speed; more than 2729 are taken for that: over
    /// two readings that are bridged nobody could tell which way it went.
    pub fn new(bus: S, most_per_tick: u16) -> Self {
        Self {
            sensor: AngleSensor::new(bus),
            most: i32::from(most_per_tick).min(TURN / 2 / i32::from(BRIDGED + 1) - 1),
            counts: None,
            bad: 0,
        }
    }

    /// Reads the sensor, once a tick.
    pub fn tick(&mut self) -> Angle {
        let read = self.sensor.read().and_then(|angle| self.widen(angle));
        let fault = read.err();
        if let Ok(counts) = read {
            self.counts = Some(counts);
            self.bad = 0;
        } else {
            self.bad = self.bad.saturating_add(1);
        }
        Angle {
            counts: self.counts.unwrap_or(0),
            broken: self.bad > BRIDGED,
            fault,
        }
    }

    /// The nearest count with this angle, if the joint can be there.
    fn widen(&self, angle: u16) -> Result<i32, AngleFault> {
        let angle = i32::from(angle);
        let Some(before) = self.counts else {
            return Ok(angle);
        };
        let ahead = angle.wrapping_sub(before).rem_euclid(TURN);
        let moved = if ahead < TURN / 2 {
            ahead
        } else {
            ahead - TURN
        };
        // Since the last good reading; what a broken sensor stood for is not known any more.
        let ticks = i32::from(self.bad.min(BRIDGED)) + 1;
        if moved.abs() > self.most * ticks {
            return Err(AngleFault::Jump);
        }
        Ok(before.wrapping_add(moved))
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use embedded_hal::spi::{self, Operation};
    use embedded_hal_mock::eh1::spi::{Mock, Transaction};
    use std::cell::RefCell;
    use std::rc::Rc;
    use std::vec::Vec;

    /// A sensor as the data sheet has it.
    #[derive(Debug, Default)]
    pub struct Sensor {
        pub angle: u16,
        pub diagnostics: u16,
        pub errors: u16,
        /// What the next frame answers.
        answer: u16,
        /// The line to the controller, where it is stuck.
        pub stuck: Option<u16>,
        /// The bus refuses from this frame on.
        pub refuses_from: u32,
        /// Bits of the next answer that flip on the way.
        pub flip: u16,
        pub frames: u32,
    }

    /// Its bus, as long as a test looks at it.
    #[derive(Clone, Debug)]
    pub struct Bus(pub Rc<RefCell<Sensor>>);

    impl Bus {
        pub fn new() -> Bus {
            Bus(Rc::new(RefCell::new(Sensor {
                diagnostics: LF | 0x80,
                refuses_from: u32::MAX,
                ..Sensor::default()
            })))
        }
    }

    impl spi::ErrorType for Bus {
        type Error = spi::ErrorKind;
    }

    impl SpiDevice for Bus {
        fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Self::Error> {
            let mut sensor = self.0.borrow_mut();
            if sensor.frames >= sensor.refuses_from {
                return Err(spi::ErrorKind::Overrun);
            }
            let [Operation::TransferInPlace(bytes)] = operations else {
                panic!("a frame is one transfer under one chip select");
            };
            let [high, low] = bytes else {
                panic!("a frame has 16 bits");
            };
            sensor.frames += 1;
            let asked = u16::from_be_bytes([*high, *low]);
            let mut answer = sensor.answer | if sensor.errors != 0 { ERROR } else { 0 };
            if answer.count_ones() % 2 == 1 {
                answer ^= PARITY;
            }
            answer = sensor.stuck.unwrap_or(answer ^ sensor.flip);
            sensor.flip = 0;
            [*high, *low] = answer.to_be_bytes();
            if asked.count_ones() % 2 == 1 {
                sensor.errors |= 4;
            }
            sensor.answer = match asked & DATA {
                ANGLECOM => sensor.angle,
                DIAAGC => sensor.diagnostics,
                ERRFL => std::mem::take(&mut sensor.errors),
                _ => panic!("{asked:#06x}"),
            };
            Ok(())
        }
    }

    fn frame(asked: u16, answered: u16) -> [Transaction<u8>; 3] {
        [
            Transaction::transaction_start(),
            Transaction::transfer_in_place(
                asked.to_be_bytes().to_vec(),
                answered.to_be_bytes().to_vec(),
            ),
            Transaction::transaction_end(),
        ]
    }

    /// The frames of the data sheet, with their parity: reads of 0x3FFF, 0x3FFC and 0x0001.
    #[test]
    fn two_frames_a_tick_of_which_the_second_answers_the_first() {
        let expected: Vec<_> = [
            (0x4001, 0x1234),
            (0xFFFC, 0x0000),
            (0xFFFF, 0x0180),
            (0xFFFC, 0x0123),
            (0xFFFF, 0x0180),
            (0xFFFC, 0x9234),
        ]
        .into_iter()
        .flat_map(|(asked, answered)| frame(asked, answered))
        .collect();
        let mut mock = Mock::new(&expected);
        let mut sensor = AngleSensor::new(mock.clone());
        let answers = [sensor.read(), sensor.read()];
        mock.done();
        assert_eq!(answers, [Ok(0x0123), Ok(0x1234)]);
    }

    /// At each frame of a reading: no more frames, and the next reading begins anew.
    #[test]
    fn an_error_of_the_bus_ends_the_reading_at_once() {
        for at in 0..4 {
            let bus = Bus::new();
            let mut sensor = AngleSensor::new(bus.clone());
            bus.0.borrow_mut().angle = 99;
            bus.0.borrow_mut().refuses_from = at;
            assert_eq!(sensor.read(), Err(AngleFault::Bus));
            assert_eq!(bus.0.borrow().frames, at);
            bus.0.borrow_mut().refuses_from = u32::MAX;
            assert_eq!(sensor.read(), Ok(99));
            assert_eq!(bus.0.borrow().frames, at + 4);
        }
    }

    /// An angle of 0 is a frame of zeros, as a line that is shorted to ground gives.
    #[test]
    fn stuck_lines_are_told_from_angles() {
        let bus = Bus::new();
        let mut sensor = AngleSensor::new(bus.clone());
        assert_eq!(sensor.read(), Ok(0));
        bus.0.borrow_mut().angle = DATA;
        assert_eq!(sensor.read(), Ok(DATA));
        for stuck in [0, u16::MAX] {
            bus.0.borrow_mut().stuck = Some(stuck);
            assert_eq!(sensor.read(), Err(AngleFault::Stuck));
            assert_eq!(sensor.read(), Err(AngleFault::Stuck));
            bus.0.borrow_mut().stuck = None;
            assert_eq!(sensor.read(), Ok(DATA));
        }
    }

    #[test]
    fn no_single_bit_that_flips_becomes_an_angle() {
        let bus = Bus::new();
        let mut sensor = AngleSensor::new(bus.clone());
        bus.0.borrow_mut().angle = 0x1555;
        for bit in 0..16 {
            assert_eq!(sensor.read(), Ok(0x1555));
            // Of the diagnostics, whose frame comes first.
            bus.0.borrow_mut().flip = 1 << bit;
            assert_eq!(sensor.read(), Err(AngleFault::Parity), "bit {bit}");
        }
    }

    #[test]
    fn an_error_flag_is_read_cleared_and_told() {
        let bus = Bus::new();
        let mut sensor = AngleSensor::new(bus.clone());
        bus.0.borrow_mut().angle = 77;
        assert_eq!(sensor.read(), Ok(77));
        for flags in [1, 2, 4] {
            bus.0.borrow_mut().errors = flags;
            assert_eq!(sensor.read(), Err(AngleFault::Refused { flags }));
            assert_eq!(bus.0.borrow().errors, 0, "cleared");
            assert_eq!(sensor.read(), Ok(77));
        }
        // One from before our time is nobody's fault.
        bus.0.borrow_mut().errors = 4;
        assert_eq!(AngleSensor::new(bus.clone()).read(), Ok(77));
    }

    #[test]
    fn a_magnet_that_is_not_right_gives_no_angle() {
        let bus = Bus::new();
        let mut sensor = AngleSensor::new(bus.clone());
        for diagnostics in [LF | MAGL, LF | MAGH, LF | COF, 0x80] {
            bus.0.borrow_mut().diagnostics = diagnostics;
            // It is the tick before's, of which the next one hears.
            let _ = sensor.read();
            assert_eq!(sensor.read(), Err(AngleFault::Magnet { diagnostics }));
        }
    }

    #[test]
    fn counts_go_on_beyond_a_turn_both_ways() {
        let bus = Bus::new();
        let mut encoder = AngleEncoder::new(bus.clone(), 500);
        let mut at = 16_000_i32;
        let mut random = 1_u32;
        bus.0.borrow_mut().angle = 16_000;
        assert_eq!(encoder.tick().counts, at);
        for _ in 0..20_000 {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            // Both ways, and one way in the long run.
            at += (random >> 16) as i32 % 901 - 400;
            bus.0.borrow_mut().angle = at.rem_euclid(TURN) as u16;
            let angle = encoder.tick();
            assert_eq!((angle.counts, angle.fault), (at, None));
        }
        assert!(at > 20 * TURN, "{at}");
    }

    #[test]
    fn two_bad_readings_are_bridged_and_a_third_is_a_broken_sensor() {
        let bus = Bus::new();
        let mut encoder = AngleEncoder::new(bus.clone(), 100);
        encoder.tick();
        for bad in 1..=4 {
            bus.0.borrow_mut().refuses_from = 0;
            let angle = encoder.tick();
            assert_eq!(angle.fault, Some(AngleFault::Bus));
            assert_eq!((angle.counts, angle.broken), (0, bad > 2));
        }
        bus.0.borrow_mut().refuses_from = u32::MAX;
        assert!(!encoder.tick().broken);
        // It went on meanwhile: three ticks' way are believed after two that were lost.
        for (lost, angle, counts) in [(2, 290, 290), (1, 480, 480), (0, 380, 380)] {
            bus.0.borrow_mut().refuses_from = 0;
            (0..lost).for_each(|_| assert!(encoder.tick().fault.is_some()));
            bus.0.borrow_mut().refuses_from = u32::MAX;
            bus.0.borrow_mut().angle = angle;
            assert_eq!(encoder.tick().counts, counts);
        }
    }

    #[test]
    fn no_step_is_larger_than_the_joint_can_make() {
        let bus = Bus::new();
        let mut encoder = AngleEncoder::new(bus.clone(), 100);
        encoder.tick();
        bus.0.borrow_mut().angle = 101;
        assert_eq!(
            encoder.tick(),
            Angle {
                counts: 0,
                broken: false,
                fault: Some(AngleFault::Jump)
            }
        );
        // Two ticks' way are within what it can have gone by now.
        assert_eq!(encoder.tick().counts, 101);
        bus.0.borrow_mut().angle = 9_000;
        let told: [bool; 5] = core::array::from_fn(|_| encoder.tick().broken);
        assert_eq!(told, [false, false, true, true, true]);
        // Whatever the joint is said to be able to.
        let bus = Bus::new();
        let mut encoder = AngleEncoder::new(bus.clone(), u16::MAX);
        encoder.tick();
        bus.0.borrow_mut().angle = 2730;
        assert_eq!(encoder.tick().fault, Some(AngleFault::Jump));
    }
}
