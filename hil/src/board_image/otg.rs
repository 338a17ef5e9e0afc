//! The chip's USB core, OTG FS, at the level of its FIFOs (RM0090, 34).
//!
//! Entry points for the image: [`Otg::read`], [`Otg::write`]; for what is on the cable: [`Otg::signal_reset`], [`Otg::give`],
//! [`Otg::take`]. A packet down waits until its endpoint is enabled and the receive FIFO has room; a packet up leaves when all of it
//! is in its FIFO and somebody takes it.

use std::collections::{BTreeMap, VecDeque};

/// First address.
pub const OTG: u32 = 0x5000_0000;

/// Offsets of registers.
const GAHBCFG: u32 = 0x008;
const GRSTCTL: u32 = 0x010;
const GINTSTS: u32 = 0x014;
const GINTMSK: u32 = 0x018;
const GRXSTSR: u32 = 0x01C;
const GRXSTSP: u32 = 0x020;
const GRXFSIZ: u32 = 0x024;
const CID: u32 = 0x03C;
const DCTL: u32 = 0x804;
const DSTS: u32 = 0x808;
const DIEPMSK: u32 = 0x810;
const DAINTMSK: u32 = 0x81C;
/// Of endpoint 0; each next one is 0x20 on.
const IN: u32 = 0x900;
const OUT: u32 = 0xB00;
/// Of endpoint 0; each next one is 0x1000 on.
const FIFO: u32 = 0x1000;
const FIFO_END: u32 = FIFO + ENDPOINTS as u32 * 0x1000;

/// Endpoints of this core in each direction.
const ENDPOINTS: usize = 4;
/// Words that a FIFO up takes: what the driver gives each of them.
const FIFO_WORDS: usize = 16;

const RESET: u32 = 1 << 12;
const ENUMERATED: u32 = 1 << 13;
const ENABLE: u32 = 1 << 31;
const STALL: u32 = 1 << 21;
const COMPLETE: u32 = 1;

/// What the receive FIFO says of a packet (GRXSTSR, PKTSTS).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Down {
    /// Data of an OUT packet.
    Data = 2,
    /// The end of an OUT transfer.
    DataEnd = 3,
    /// The end of a SETUP.
    SetupEnd = 4,
    /// A SETUP packet.
    Setup = 6,
}

#[derive(Clone, Debug, Default)]
struct Endpoint {
    control: u32,
    interrupt: u32,
    size: u32,
    fifo: Vec<u8>,
    /// A packet up waits to be taken.
    is_due: bool,
    /// A packet down would be taken.
    takes: bool,
}

/// The core.
#[derive(Clone, Debug, Default)]
pub struct Otg {
    /// What it says it is.
    id: u32,
    stored: BTreeMap<u32, u32>,
    reset: bool,
    enumerated: bool,
    endpoints: [Endpoint; ENDPOINTS],
    /// Entries of the receive FIFO: endpoint, what, bytes.
    received: VecDeque<(usize, Down, Vec<u8>)>,
    /// Words of the packet that was popped.
    popped: VecDeque<u32>,
    /// The bus was reset, and nobody has said that the device is set up.
    pub sets_up: bool,
}

impl Otg {
    /// A core that says it is this.
    pub fn new(id: u32) -> Otg {
        Otg {
            id,
            ..Otg::default()
        }
    }

    /// What a read of a register gives, without what it does.
    pub fn peek(&self, offset: u32) -> u32 {
        let endpoint = |base: u32| self.endpoints.get(((offset - base) / 0x20) as usize);
        match offset {
            // Idle; flushing takes no time.
            GRSTCTL => 1 << 31,
            GINTSTS => self.interrupts(),
            GRXSTSR | GRXSTSP => self.status(),
            CID => self.id,
            // Full speed.
            DSTS => 3 << 1,
            IN..0x980 => endpoint(IN).map_or(0, |endpoint| match offset & 0x1F {
                0x00 => endpoint.control | if endpoint.is_due { ENABLE } else { 0 },
                0x08 => endpoint.interrupt,
                0x10 => endpoint.size,
                0x18 => FIFO_WORDS.saturating_sub(endpoint.fifo.len().div_ceil(4)) as u32,
                _ => 0,
            }),
            OUT..0xB80 => match (endpoint(OUT), offset & 0x1F) {
                (Some(endpoint), 0x00) if endpoint.takes => self.stored(offset) | ENABLE,
                _ => self.stored(offset),
            },
            FIFO..FIFO_END => self.popped.front().copied().unwrap_or(0),
            _ => self.stored(offset),
        }
    }

    /// A read of a register.
    pub fn read(&mut self, offset: u32) -> u32 {
        let value = self.peek(offset);
        match offset {
            GRXSTSP => {
                if let Some((_, _, bytes)) = self.received.pop_front() {
                    self.popped = bytes.chunks(4).map(word).collect();
                }
            }
            FIFO..FIFO_END => {
                self.popped.pop_front();
            }
            _ => {}
        }
        value
    }

    /// A write to a register.
    pub fn write(&mut self, offset: u32, value: u32) {
        match offset {
            GINTSTS => {
                self.reset &= value & RESET == 0;
                self.enumerated &= value & ENUMERATED == 0;
            }
            IN..0x980 => {
                let at = ((offset - IN) / 0x20) as usize;
                let Some(endpoint) = self.endpoints.get_mut(at) else {
                    return;
                };
                match offset & 0x1F {
                    0x00 => {
                        // Bits that act and do not stay: CNAK, SNAK, SD0PID, EPDIS, EPENA.
                        endpoint.control = value & 0x03FF_FFFF;
                        if value & ENABLE != 0 {
                            endpoint.is_due = true;
                            endpoint.fifo.clear();
                        }
                    }
                    0x08 => endpoint.interrupt &= !value,
                    0x10 => endpoint.size = value,
                    _ => {}
                }
            }
            OUT..0xB80 => {
                let at = ((offset - OUT) / 0x20) as usize;
                self.stored.insert(offset, value & 0x03FF_FFFF);
                if let Some(endpoint) = self.endpoints.get_mut(at)
                    && offset & 0x1F == 0
                {
                    endpoint.takes |= value & ENABLE != 0;
                }
            }
            FIFO..FIFO_END => {
                let at = ((offset - FIFO) / 0x1000) as usize;
                if let Some(endpoint) = self.endpoints.get_mut(at).filter(|e| e.is_due) {
                    endpoint.fifo.extend(value.to_le_bytes());
                }
            }
            _ => {
                self.stored.insert(offset, value);
            }
        }
    }

    /// Registers that have to be watched for reads now: those that are not 0, or whose reads do something.
    pub fn watched(&self) -> Vec<u32> {
        let mut watched = Vec::new();
        if self.interrupts() != 0 {
            watched.push(GINTSTS);
        }
        if !self.received.is_empty() {
            // What the core is makes a difference only where a packet is taken from it.
            watched.extend([CID, GRXSTSR, GRXSTSP]);
        }
        if !self.received.is_empty() || !self.popped.is_empty() {
            watched.push(FIFO);
        }
        for (at, endpoint) in (0..).zip(&self.endpoints) {
            let base = IN + 0x20 * at;
            if endpoint.interrupt != 0 {
                watched.push(base + 0x08);
            }
            // In use (USBAEP), or the control endpoint: whether it is busy, and its room.
            if at == 0 || endpoint.control & 1 << 15 != 0 {
                watched.extend([base, base + 0x18]);
            }
        }
        watched
    }

    /// Whether the core asks for its interrupt.
    pub fn interrupts_now(&self) -> bool {
        self.stored(GAHBCFG) & 1 != 0 && self.interrupts() & self.stored(GINTMSK) != 0
    }

    /// Whether the device shows itself on the cable.
    pub fn is_connected(&self) -> bool {
        self.stored(GAHBCFG) & 1 != 0 && self.stored(DCTL) & 1 << 1 == 0
    }

    /// The host resets the bus.
    pub fn signal_reset(&mut self) {
        self.reset = true;
        self.sets_up = true;
        self.received.clear();
        self.popped.clear();
        self.endpoints = Default::default();
    }

    /// The reset is over, at full speed.
    pub fn signal_speed(&mut self) {
        self.enumerated = true;
    }

    /// Hands the device a packet; false if it does not take one now. A SETUP is always taken.
    pub fn give(&mut self, endpoint: usize, what: Down, bytes: &[u8]) -> bool {
        let words: usize = self
            .received
            .iter()
            .map(|(_, _, bytes)| 1 + bytes.len().div_ceil(4))
            .sum();
        let room = (self.stored(GRXFSIZ) as usize).saturating_sub(words);
        let Some(at) = self.endpoints.get_mut(endpoint) else {
            return false;
        };
        let end = match what {
            Down::Setup => Down::SetupEnd,
            _ if at.takes && room >= bytes.len().div_ceil(4) + 2 => Down::DataEnd,
            _ => return false,
        };
        at.takes = false;
        self.received.push_back((endpoint, what, bytes.to_vec()));
        self.received.push_back((endpoint, end, Vec::new()));
        true
    }

    /// Takes a packet that the device has ready.
    pub fn take(&mut self, endpoint: usize) -> Option<Vec<u8>> {
        let endpoint = self.endpoints.get_mut(endpoint)?;
        let length = (endpoint.size & 0x7_FFFF) as usize;
        if !endpoint.is_due || endpoint.fifo.len() < length {
            return None;
        }
        endpoint.is_due = false;
        endpoint.interrupt |= COMPLETE;
        endpoint.size = 0;
        let mut packet = std::mem::take(&mut endpoint.fifo);
        packet.truncate(length);
        Some(packet)
    }

    /// Whether the device refuses what was asked on the control endpoint.
    pub fn stalls(&self) -> bool {
        self.endpoints[0].control & STALL != 0
    }

    /// Entries of the receive FIFO that the image has not taken.
    pub fn waiting(&self) -> usize {
        self.received.len()
    }

    fn stored(&self, offset: u32) -> u32 {
        self.stored.get(&offset).copied().unwrap_or(0)
    }

    fn interrupts(&self) -> u32 {
        let mask = self.stored(DAINTMSK);
        let complete = (0..).zip(&self.endpoints).any(|(at, endpoint)| {
            mask & 1 << at != 0 && endpoint.interrupt & self.stored(DIEPMSK) != 0
        });
        let bit = |set, at: u32| if set { at } else { 0 };
        bit(self.reset, RESET)
            | bit(self.enumerated, ENUMERATED)
            | bit(!self.received.is_empty(), 1 << 4)
            | bit(complete, 1 << 18)
    }

    /// GRXSTSR: endpoint, bytes, what.
    fn status(&self) -> u32 {
        self.received.front().map_or(0, |(endpoint, what, bytes)| {
            *endpoint as u32 | (bytes.len() as u32) << 4 | (*what as u32) << 17
        })
    }
}

fn word(bytes: &[u8]) -> u32 {
    let byte = |at: usize| u32::from(bytes.get(at).copied().unwrap_or(0));
    byte(0) | byte(1) << 8 | byte(2) << 16 | byte(3) << 24
}

#[cfg(test)]
mod tests {
    use super::*;

    fn core() -> Otg {
        let mut otg = Otg::default();
        for (offset, value) in [
            (GAHBCFG, 1),
            (GINTMSK, 1 << 4 | 1 << 18 | RESET | ENUMERATED),
            (GRXFSIZ, 62),
            (DIEPMSK, 1),
            (DAINTMSK, 0b100),
            (OUT + 0x20, ENABLE | 64),
            (IN + 0x40, 1 << 15 | 64),
        ] {
            otg.write(offset, value);
        }
        otg
    }

    #[test]
    fn a_packet_down_waits_for_its_endpoint() {
        let mut otg = core();
        assert!(otg.give(1, Down::Data, &[1, 2, 3, 4, 5]));
        assert!(!otg.give(1, Down::Data, &[6]), "not enabled again");
        assert!(otg.interrupts_now());
        assert_eq!(otg.peek(GRXSTSR), 1 | 5 << 4 | 2 << 17);
        otg.read(GRXSTSP);
        assert_eq!(otg.read(FIFO), 0x0403_0201);
        assert_eq!(otg.read(FIFO), 5);
        assert_eq!(otg.read(GRXSTSP), 1 | 3 << 17);
        assert!(!otg.interrupts_now());
        otg.write(OUT + 0x20, ENABLE);
        assert!(otg.give(1, Down::Data, &[6]));
    }

    #[test]
    fn a_packet_up_leaves_whole_and_once() {
        let mut otg = core();
        otg.write(IN + 0x50, 1 << 19 | 5);
        otg.write(IN + 0x40, ENABLE | 1 << 26 | 1 << 15);
        otg.write(FIFO + 0x2000, 0x0403_0201);
        assert_eq!(otg.take(2), None, "half of it");
        assert_eq!(otg.peek(IN + 0x58), 15, "words of room");
        otg.write(FIFO + 0x2000, 5);
        assert_ne!(otg.peek(IN + 0x40) & ENABLE, 0);
        assert_eq!(otg.take(2), Some(vec![1, 2, 3, 4, 5]));
        assert_eq!(otg.take(2), None);
        assert_eq!(otg.peek(IN + 0x40) & ENABLE, 0);
        assert!(otg.interrupts_now());
        otg.write(IN + 0x48, COMPLETE);
        assert!(!otg.interrupts_now());
    }

    #[test]
    fn masks_keep_the_interrupt_away() {
        let mut otg = core();
        otg.write(GAHBCFG, 0);
        assert!(otg.give(1, Down::Data, &[1]));
        assert!(!otg.interrupts_now());
        otg.write(GAHBCFG, 1);
        otg.write(GINTMSK, 0);
        assert!(!otg.interrupts_now());
    }

    #[test]
    fn what_is_not_0_is_watched() {
        let mut otg = core();
        let sees = |otg: &Otg| {
            let watched = otg.watched();
            for offset in [GINTSTS, GRXSTSR, GRXSTSP, IN + 0x08, IN + 0x28, IN + 0x48] {
                let is_watched = watched.contains(&offset);
                assert_eq!(is_watched, otg.peek(offset) != 0, "{offset:#x}");
            }
        };
        sees(&otg);
        otg.give(1, Down::Data, &[1; 64]);
        sees(&otg);
        otg.signal_reset();
        sees(&otg);
    }
}
