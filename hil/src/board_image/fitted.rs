//! What is wired to the chip of a board with everything on it: the other ends of the lines of `firmware/src/board/fitted.rs`.
//!
//! Entry point: [`BoardImage::fit`](super::BoardImage::fit). The angle sensor of joint 3 turns as its encoder would have counted.

const ADC1: u32 = 0x4001_2000;
const ADC2: u32 = 0x4001_2100;
/// Status, end of conversion; data.
const SR: u32 = 0x00;
const END: u32 = 1 << 1;
const DR: u32 = 0x4C;
const SPI3_SR: u32 = 0x4000_3C08;
/// Data register of SPI3, whose writes are to be watched: QEMU has one that nothing is connected to.
pub const SPI3_DR: u32 = 0x4000_3C0C;
/// A byte can be written, and one has come: the bus takes no time.
const READY: u32 = 0b11;
/// Neither, for ever: the unit has lost its clock, or is broken.
const DEAD: u32 = 0;
const GPIOD_IDR: u32 = 0x4002_0C10;
const GPIOD_BSRR: u32 = 0x4002_0C18;
/// PD2, set and reset.
const DESELECT: u32 = 1 << 2;
const SELECT: u32 = 1 << 18;

/// Full scale of a converter, and what the supply is there \[V\].
const FULL_SCALE: f32 = 4095.0;
const SUPPLY_SCALE_V: f32 = 36.3;

/// What is wired to it.
#[derive(Clone, Copy, Debug)]
pub struct Fitted {
    /// The motors' supply \[V\].
    pub supply_v: f32,
    /// Voltage at the thermistor, as a part of the converter's reference: a half is 25 degrees Celsius.
    pub thermistor: f32,
    /// Contacts of joint 1's end stops that are closed: lower, upper.
    pub stops_closed: [bool; 2],
    /// What the line from the angle sensor is stuck at.
    pub stuck: Option<u16>,
    /// The chip's SPI unit takes and gives nothing.
    pub bus_dead: bool,
    /// Bytes of the present frame, and how many.
    frame: u16,
    bytes: u32,
    /// What the next frame answers.
    answer: u16,
}

impl Fitted {
    /// Everything as it should be.
    pub(super) const WELL: Fitted = Fitted {
        supply_v: 24.0,
        thermistor: 0.5,
        stops_closed: [true; 2],
        stuck: None,
        bus_dead: false,
        frame: 0,
        bytes: 0,
        answer: 0,
    };

    /// Registers whose reads have to be answered.
    pub(super) const WATCHED: [u32; 7] = [
        ADC1 + SR,
        ADC1 + DR,
        ADC2 + SR,
        ADC2 + DR,
        SPI3_SR,
        SPI3_DR,
        GPIOD_IDR,
    ];

    /// What a read gives, of a register of these.
    pub(super) fn peek(&self, address: u32) -> Option<u32> {
        let reading = |part: f32| (part.clamp(0.0, 1.0) * FULL_SCALE) as u32;
        let [lower, upper] = self.stops_closed;
        let answer = self.stuck.unwrap_or(self.answer).to_be_bytes();
        Some(match address {
            _ if address == ADC1 + SR || address == ADC2 + SR => END,
            _ if address == ADC1 + DR => reading(self.supply_v / SUPPLY_SCALE_V),
            _ if address == ADC2 + DR => reading(self.thermistor),
            SPI3_SR if self.bus_dead => DEAD,
            SPI3_SR => READY,
            SPI3_DR => u32::from(answer[usize::from(self.bytes > 1)]),
            GPIOD_IDR => u32::from(lower) << 7 | u32::from(upper) << 6,
            _ => return None,
        })
    }

    /// A write to a register; `counts` is where joint 3 is.
    pub(super) fn write(&mut self, address: u32, value: u32, counts: i32) {
        match address {
            SPI3_DR => {
                self.frame = self.frame << 8 | (value as u16 & 0xFF);
                self.bytes += 1;
            }
            GPIOD_BSRR if value & SELECT != 0 => self.bytes = 0,
            GPIOD_BSRR if value & DESELECT != 0 && self.bytes == 2 => {
                self.answer = answer(self.frame, counts);
                self.bytes = 0;
            }
            _ => {}
        }
    }
}

/// What an AS5047 answers to a frame in the next one (its data sheet, 7.3 and 7.4), with even parity.
fn answer(asked: u16, counts: i32) -> u16 {
    let data = match asked & 0x3FFF {
        0x3FFF => counts.rem_euclid(1 << 14) as u16,
        // It has started, and its gain is in the middle.
        0x3FFC => 0x0180,
        _ => 0,
    };
    if data.count_ones() % 2 == 1 {
        data | 1 << 15
    } else {
        data
    }
}
