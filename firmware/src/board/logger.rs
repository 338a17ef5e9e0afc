//! The log: one logger for defmt, which a probe reads through RTT and a host over USB.
//!
//! Entry points: defmt's macros, below control priority only; [`LogClass`] for USB; [`lost`] for what did not fit.
//!
//! Nobody waits, and no interrupt is held back: whoever logs while a frame is being written, which is a task above it, loses its own. Each of
//! the two ways has a ring of its own ([`crate::log_ring`]), so that one that nobody reads costs the other nothing.

use crate::log_ring::Ring;
use core::sync::atomic::{AtomicU8, AtomicU32, Ordering};
use sutura_shared::usb::LOG_INTERFACE;
use usb_device::class_prelude::*;
use usb_device::descriptor::lang_id::LangID;

/// Bytes of each ring: some thirty frames.
const SIZE: usize = 1024;

type Bytes = [AtomicU8; SIZE];

static RTT_BYTES: Bytes = [const { AtomicU8::new(0) }; SIZE];
static USB_BYTES: Bytes = [const { AtomicU8::new(0) }; SIZE];
static USB_OFFSETS: [AtomicU32; 2] = [const { AtomicU32::new(0) }; 2];

/// A channel as a probe finds it in RAM (SEGGER J-Link user guide UM08001, 16.4). Of its flags, which a probe may set so that a full
/// channel waits, nothing is read here.
#[repr(C)]
struct Channel {
    name: &'static [u8; 6],
    bytes: &'static Bytes,
    size: u32,
    written: AtomicU32,
    read: AtomicU32,
    flags: AtomicU32,
}

/// All channels, of which there is one, to the probe.
#[repr(C)]
struct ControlBlock {
    mark: [u8; 16],
    up: u32,
    down: u32,
    channel: Channel,
}

#[unsafe(no_mangle)]
static _SEGGER_RTT: ControlBlock = ControlBlock {
    mark: *b"SEGGER RTT\0\0\0\0\0\0",
    up: 1,
    down: 0,
    channel: Channel {
        name: b"defmt\0",
        bytes: &RTT_BYTES,
        size: SIZE as u32,
        written: AtomicU32::new(0),
        read: AtomicU32::new(0),
        flags: AtomicU32::new(0),
    },
};

static RTT: Ring = Ring::new(
    &RTT_BYTES,
    &_SEGGER_RTT.channel.written,
    &_SEGGER_RTT.channel.read,
);
static USB: Ring = Ring::new(&USB_BYTES, &USB_OFFSETS[0], &USB_OFFSETS[1]);

/// Frames that are being written: above 1, the ones of tasks that have interrupted the first.
static DEPTH: AtomicU32 = AtomicU32::new(0);
static mut ENCODER: defmt::Encoder = defmt::Encoder::new();

#[defmt::global_logger]
struct Logger;

fn push(bytes: &[u8]) {
    RTT.push(bytes);
    USB.push(bytes);
}

/// What defmt encodes with.
///
/// # Safety
/// For who has found depth 0, until its `release`: nobody else has a reference then.
unsafe fn encoder() -> &'static mut defmt::Encoder {
    let place = &raw mut ENCODER;
    // SAFETY: as above; the static is aligned and has its value from the start.
    unsafe { &mut *place }
}

// SAFETY: a task that interrupts another one ends before that goes on, so that whoever finds depth 0 is alone with the encoder and the
// rings' writing ends until its own `release`; all others leave them alone.
unsafe impl defmt::Logger for Logger {
    fn acquire() {
        let depth = DEPTH.load(Ordering::Relaxed);
        DEPTH.store(depth + 1, Ordering::Relaxed);
        if depth > 0 {
            return;
        }
        RTT.begin();
        USB.begin();
        // SAFETY: as above; nobody else has a reference.
        unsafe { encoder().start_frame(push) };
    }

    unsafe fn flush() {}

    unsafe fn release() {
        let depth = DEPTH.load(Ordering::Relaxed);
        if depth == 1 {
            // SAFETY: as above.
            unsafe { encoder().end_frame(push) };
            RTT.commit();
            USB.commit();
        } else {
            RTT.lose();
            USB.lose();
        }
        DEPTH.store(depth.saturating_sub(1), Ordering::Relaxed);
    }

    unsafe fn write(bytes: &[u8]) {
        if DEPTH.load(Ordering::Relaxed) == 1 {
            // SAFETY: as above.
            unsafe { encoder().write(bytes, push) };
        }
    }
}

/// What [`lost`] said last.
static TOLD: [AtomicU32; 2] = [const { AtomicU32::new(0) }; 2];

/// Frames that were lost so far, on the way to a probe and over USB, if one of the two has changed and there is room there to say so.
pub fn lost() -> Option<[u32; 2]> {
    let (rings, lost) = ([&RTT, &USB], [RTT.lost(), USB.lost()]);
    let mut news = rings.iter().zip(&lost).zip(&TOLD);
    let say =
        news.any(|((ring, &lost), told)| lost != told.load(Ordering::Relaxed) && ring.has_room());
    say.then(|| {
        for (told, lost) in TOLD.iter().zip(lost) {
            told.store(lost, Ordering::Relaxed);
        }
        lost
    })
}

/// Console time of the last tick \[us\], low word first.
static TIME: [AtomicU32; 2] = [const { AtomicU32::new(0) }; 2];

/// The control task's: a tick has begun at this console time \[us\].
pub fn set_time(us: u64) {
    TIME[1].store((us >> 32) as u32, Ordering::Relaxed);
    TIME[0].store(us as u32, Ordering::Relaxed);
}

// A tick in between is noticed once in 71 minutes, and then a line has the wrong hour.
defmt::timestamp!("{=u64:us}", {
    u64::from(TIME[1].load(Ordering::Relaxed)) << 32 | u64::from(TIME[0].load(Ordering::Relaxed))
});

/// Longest packet \[bytes\]. A host's read ends at a packet that is shorter than an endpoint's, and so at each.
const PACKET: usize = 63;

/// The log as an interface of USB's: one bulk endpoint to the host, with what defmt has encoded.
pub struct LogClass<'a, B: UsbBus> {
    interface: InterfaceNumber,
    name: StringIndex,
    endpoint: EndpointIn<'a, B>,
    /// A packet waits to be fetched.
    busy: bool,
}

impl<'a, B: UsbBus> LogClass<'a, B> {
    /// Takes an interface and an endpoint of the bus.
    pub fn new(bus: &'a UsbBusAllocator<B>) -> Self {
        LogClass {
            interface: bus.interface(),
            name: bus.string(),
            endpoint: bus.bulk(64),
            busy: false,
        }
    }

    /// Gives the next packet to the endpoint, if the last one has been fetched and there is anything to say.
    pub fn give(&mut self) {
        if self.busy {
            return;
        }
        let mut packet = [0; PACKET];
        let count = USB.peek(&mut packet);
        if count == 0 {
            return;
        }
        if self
            .endpoint
            .write(packet.get(..count).unwrap_or_default())
            .is_ok()
        {
            self.busy = true;
            USB.drop_front(count);
        }
    }
}

impl<B: UsbBus> UsbClass<B> for LogClass<'_, B> {
    fn get_configuration_descriptors(
        &self,
        writer: &mut DescriptorWriter,
    ) -> usb_device::Result<()> {
        let [class, subclass, protocol] = LOG_INTERFACE;
        writer.interface_alt(
            self.interface,
            0,
            class,
            subclass,
            protocol,
            Some(self.name),
        )?;
        writer.endpoint(&self.endpoint)
    }

    fn get_string(&self, index: StringIndex, _: LangID) -> Option<&str> {
        (index == self.name).then_some(super::NAME)
    }

    fn endpoint_in_complete(&mut self, address: EndpointAddress) {
        self.busy &= address != self.endpoint.address();
    }

    fn reset(&mut self) {
        self.busy = false;
    }
}
