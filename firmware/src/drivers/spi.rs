//! The one device of an SPI bus, with a bound on how long each byte of it is waited for.
//!
//! Entry point: [`Selected`], which drivers take as their `SpiDevice`. A bus that waits until the chip's unit has a byte waits for ever if that unit is
//! dead, and holds the tick up until a watchdog resets the chip. Here a byte has [`MOST_CLOCKS`] of the bus, and the transaction ends with an error
//! then, with the device let go: what becomes of that is the driver's, see [`crate::drivers::angle`].

use embedded_hal::delay::DelayNs;
use embedded_hal::digital::OutputPin;
use embedded_hal::spi::{Error, ErrorKind, ErrorType, Operation, SpiDevice};
use embedded_hal_nb::nb;
use embedded_hal_nb::spi::FullDuplex;

/// Clocks of the bus that a byte may take: four times its own eight.
pub const MOST_CLOCKS: u32 = 32;

/// Why a transaction has ended early.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SpiFault {
    /// The chip's unit says so.
    Bus(ErrorKind),
    /// It did not take or give a byte within [`MOST_CLOCKS`].
    TimedOut,
    /// The chip select did not obey.
    Select,
}

impl Error for SpiFault {
    fn kind(&self) -> ErrorKind {
        match self {
            SpiFault::Bus(kind) => *kind,
            SpiFault::TimedOut => ErrorKind::Other,
            SpiFault::Select => ErrorKind::ChipSelectFault,
        }
    }
}

/// A device that is selected while its line is low.
#[derive(Debug)]
pub struct Selected<B, S, D> {
    bus: B,
    select: S,
    delay: D,
    /// A period of the bus' clock \[ns\], rounded up.
    clock_ns: u32,
    /// Between the select line and the clock, both ways, and between two transactions \[ns\].
    settle_ns: u32,
    /// The last byte was not waited for to its end, and may have come since.
    late: bool,
}

impl<B: FullDuplex, S: OutputPin, D: DelayNs> Selected<B, S, D> {
    /// The device of a bus that runs at `bus_hz`. `select`: its line, which is high by now; `settle_ns`: the device's, from its data sheet.
    pub fn new(bus: B, select: S, delay: D, bus_hz: u32, settle_ns: u32) -> Self {
        Self {
            bus,
            select,
            delay,
            clock_ns: 1_000_000_000_u32.div_ceil(bus_hz.max(1)),
            settle_ns,
            late: false,
        }
    }

    fn run(&mut self, operation: &mut Operation<'_, u8>) -> Result<(), SpiFault> {
        match operation {
            Operation::Read(bytes) => bytes.iter_mut().try_for_each(|byte| {
                *byte = self.exchange(0)?;
                Ok(())
            }),
            Operation::Write(bytes) => bytes
                .iter()
                .try_for_each(|byte| self.exchange(*byte).map(|_| ())),
            Operation::Transfer(taken, given) => {
                (0..taken.len().max(given.len())).try_for_each(|at| {
                    let byte = self.exchange(given.get(at).copied().unwrap_or(0))?;
                    if let Some(place) = taken.get_mut(at) {
                        *place = byte;
                    }
                    Ok(())
                })
            }
            Operation::TransferInPlace(bytes) => bytes.iter_mut().try_for_each(|byte| {
                *byte = self.exchange(*byte)?;
                Ok(())
            }),
            Operation::DelayNs(ns) => {
                self.delay.delay_ns(*ns);
                Ok(())
            }
        }
    }

    /// A byte each way.
    fn exchange(&mut self, byte: u8) -> Result<u8, SpiFault> {
        let mut clocks = MOST_CLOCKS;
        self.wait(&mut clocks, |bus| bus.write(byte))?;
        self.wait(&mut clocks, B::read)
    }

    /// Asks the unit once a clock.
    fn wait<T>(
        &mut self,
        clocks: &mut u32,
        mut ask: impl FnMut(&mut B) -> nb::Result<T, B::Error>,
    ) -> Result<T, SpiFault> {
        loop {
            match ask(&mut self.bus) {
                Ok(done) => return Ok(done),
                Err(nb::Error::Other(error)) => return Err(SpiFault::Bus(error.kind())),
                Err(nb::Error::WouldBlock) if *clocks == 0 => {
                    self.late = true;
                    return Err(SpiFault::TimedOut);
                }
                Err(nb::Error::WouldBlock) => {
                    *clocks -= 1;
                    self.delay.delay_ns(self.clock_ns);
                }
            }
        }
    }
}

impl<B, S, D> ErrorType for Selected<B, S, D> {
    type Error = SpiFault;
}

impl<B: FullDuplex, S: OutputPin, D: DelayNs> SpiDevice for Selected<B, S, D> {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), SpiFault> {
        if core::mem::take(&mut self.late) {
            // Else it would be taken for the first answer of this one.
            let _ = self.bus.read();
        }
        self.select.set_low().map_err(|_| SpiFault::Select)?;
        self.delay.delay_ns(self.settle_ns);
        let done = operations
            .iter_mut()
            .try_for_each(|operation| self.run(operation));
        self.delay.delay_ns(self.settle_ns);
        let released = self.select.set_high().map_err(|_| SpiFault::Select);
        self.delay.delay_ns(self.settle_ns);
        done.and(released)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drivers::angle::{AngleEncoder, AngleFault};
    use embedded_hal_mock::eh1::MockError;
    use embedded_hal_mock::eh1::digital::{Mock as PinMock, State, Transaction as PinCall};
    use embedded_hal_mock::eh1::spi::{Mock as BusMock, Transaction as BusCall};
    use std::cell::RefCell;
    use std::io::ErrorKind as IoKind;
    use std::rc::Rc;
    use std::vec::Vec;

    /// 5 MHz.
    const BUS_HZ: u32 = 5_000_000;
    const CLOCK_NS: u32 = 200;
    const SETTLE_NS: u32 = 500;

    /// A unit of a chip that answers each byte with one more than it.
    #[derive(Debug, Default)]
    struct Unit {
        /// Clocks until it takes a byte, and from there until it gives one.
        slow: [u32; 2],
        /// Of the present one.
        waited: [u32; 2],
        /// It says that it was overrun.
        overrun: bool,
        /// What it has been given, in order, and what it has not handed over.
        given: Vec<u8>,
        has: Option<u8>,
        /// The select line, and how often it obeyed.
        selected: bool,
        selections: u32,
        /// Time that has been waited for \[ns\].
        waited_ns: u32,
    }

    #[derive(Clone, Debug, Default)]
    struct Shared(Rc<RefCell<Unit>>);

    impl ErrorType for Shared {
        type Error = ErrorKind;
    }

    impl FullDuplex for Shared {
        fn write(&mut self, word: u8) -> nb::Result<(), ErrorKind> {
            let unit = &mut *self.0.borrow_mut();
            if unit.overrun {
                return Err(ErrorKind::Overrun.into());
            }
            if unit.waited[0] < unit.slow[0] {
                unit.waited[0] += 1;
                return Err(nb::Error::WouldBlock);
            }
            assert!(unit.selected, "a byte for nobody");
            unit.waited = [0; 2];
            unit.given.push(word);
            unit.has = Some(word.wrapping_add(1));
            Ok(())
        }

        fn read(&mut self) -> nb::Result<u8, ErrorKind> {
            let unit = &mut *self.0.borrow_mut();
            if unit.waited[1] < unit.slow[1] {
                unit.waited[1] += 1;
                return Err(nb::Error::WouldBlock);
            }
            unit.has.take().ok_or(nb::Error::WouldBlock)
        }
    }

    impl embedded_hal::digital::ErrorType for Shared {
        type Error = core::convert::Infallible;
    }

    impl OutputPin for Shared {
        fn set_low(&mut self) -> Result<(), Self::Error> {
            let mut unit = self.0.borrow_mut();
            unit.selected = true;
            unit.selections += 1;
            Ok(())
        }

        fn set_high(&mut self) -> Result<(), Self::Error> {
            self.0.borrow_mut().selected = false;
            Ok(())
        }
    }

    impl DelayNs for Shared {
        fn delay_ns(&mut self, ns: u32) {
            self.0.borrow_mut().waited_ns += ns;
        }
    }

    type Device = Selected<Shared, Shared, Shared>;

    fn device() -> (Shared, Device) {
        let unit = Shared::default();
        let [bus, select, delay] = [(); 3].map(|()| unit.clone());
        (unit, Selected::new(bus, select, delay, BUS_HZ, SETTLE_NS))
    }

    #[test]
    fn every_operation_is_so_many_bytes_under_one_select() {
        let (unit, mut device) = device();
        let (mut read, mut short, mut long, mut in_place) = ([9; 2], [9; 1], [9; 3], [7, 8]);
        let done = device.transaction(&mut [
            Operation::Write(&[1, 2]),
            Operation::Read(&mut read),
            Operation::Transfer(&mut short, &[3, 4]),
            Operation::Transfer(&mut long, &[5]),
            Operation::DelayNs(70),
            Operation::TransferInPlace(&mut in_place),
        ]);
        assert_eq!(done, Ok(()));
        let unit = unit.0.borrow();
        assert_eq!(unit.given, [1, 2, 0, 0, 3, 4, 5, 0, 0, 7, 8]);
        assert_eq!(
            (read, short, long, in_place),
            ([1; 2], [4], [6, 1, 1], [8, 9])
        );
        assert_eq!((unit.selections, unit.selected), (1, false));
        assert_eq!(unit.waited_ns, 3 * SETTLE_NS + 70);
    }

    /// Whether it is slow to take a byte or to give one: 32 clocks are enough, and 33 are not waited for.
    #[test]
    fn a_byte_is_waited_for_32_clocks_and_no_longer() {
        for slow in [[0, 32], [32, 0], [12, 20]] {
            let (unit, mut device) = device();
            unit.0.borrow_mut().slow = slow;
            let mut bytes = [1, 2];
            assert_eq!(device.transfer_in_place(&mut bytes), Ok(()), "{slow:?}");
            assert_eq!(bytes, [2, 3]);
        }
        for slow in [[0, 33], [33, 0], [12, 21], [u32::MAX, 0], [0, u32::MAX]] {
            let (unit, mut device) = device();
            unit.0.borrow_mut().slow = slow;
            let mut bytes = [1, 2];
            let done = device.transfer_in_place(&mut bytes);
            assert_eq!(done, Err(SpiFault::TimedOut), "{slow:?}");
            assert_eq!(done.map_err(|fault| fault.kind()), Err(ErrorKind::Other));
            let unit = unit.0.borrow();
            assert_eq!(unit.waited_ns, MOST_CLOCKS * CLOCK_NS + 3 * SETTLE_NS);
            // Nothing after it, and the device is let go.
            assert!(unit.given.len() <= 1 && !unit.selected, "{unit:?}");
        }
    }

    /// What a tick of an angle sensor has to wait for a dead unit: a byte's bound, once.
    #[test]
    fn a_dead_unit_costs_a_tick_ten_microseconds_and_is_a_broken_sensor_in_the_third() {
        for slow in [[u32::MAX, 0], [0, u32::MAX]] {
            let (unit, device) = device();
            unit.0.borrow_mut().slow = slow;
            let mut encoder = AngleEncoder::new(device, 100);
            for tick in 1..=5 {
                unit.0.borrow_mut().waited_ns = 0;
                let angle = encoder.tick();
                assert_eq!(angle.fault, Some(AngleFault::Bus));
                assert_eq!(angle.broken, tick > 2, "{tick}");
                assert!(unit.0.borrow().waited_ns < 10_000);
            }
        }
    }

    #[test]
    fn a_byte_that_comes_too_late_is_nobodys_answer() {
        let (unit, mut device) = device();
        unit.0.borrow_mut().slow = [0, 40];
        let mut bytes = [0x10];
        let late = device.transfer_in_place(&mut bytes);
        assert_eq!(late, Err(SpiFault::TimedOut));
        // It has come meanwhile: 0x11. The next one is answered by 0x21.
        unit.0.borrow_mut().slow = [0; 2];
        let mut bytes = [0x20];
        assert!(unit.0.borrow().has.is_some());
        let mut read = [0];
        let next = device.transaction(&mut [
            Operation::TransferInPlace(&mut bytes),
            Operation::Transfer(&mut read, &[0x30]),
        ]);
        assert_eq!((next, bytes, read), (Ok(()), [0x21], [0x31]));
    }

    #[test]
    fn an_error_of_the_unit_is_told_as_it_is_and_lets_the_device_go() {
        let (unit, mut device) = device();
        unit.0.borrow_mut().overrun = true;
        let done = device.write(&[1]);
        assert_eq!(done, Err(SpiFault::Bus(ErrorKind::Overrun)));
        assert!(!unit.0.borrow().selected);
    }

    /// The mocks of others: no call but these, errors of their own.
    #[test]
    fn a_select_line_that_does_not_obey_is_told_and_nothing_is_sent_to_nobody() {
        let error = || MockError::Io(IoKind::Other);
        let low = || PinCall::set(State::Low);
        let high = || PinCall::set(State::High);
        let one = [BusCall::write(5), BusCall::read(6)];
        for (calls, sends) in [
            (std::vec![low().with_error(error())], false),
            (std::vec![low(), high().with_error(error())], true),
        ] {
            let mut bus = BusMock::new(if sends { &one } else { &one[..0] });
            let mut select = PinMock::new(&calls);
            let mut device = Selected::new(
                bus.clone(),
                select.clone(),
                Shared::default(),
                BUS_HZ,
                SETTLE_NS,
            );
            let mut bytes = [5];
            let done = device.transfer_in_place(&mut bytes);
            assert_eq!(done, Err(SpiFault::Select));
            bus.done();
            select.done();
        }
    }
}
