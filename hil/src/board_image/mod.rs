//! The unmodified image of a board with motors, under QEMU, with a stand-in for the registers that QEMU lacks.
//!
//! Entry points: [`BoardImage::start`], [`BoardImage::tick`], [`BoardImage::enumerate`], [`BoardImage::send`], [`BoardImage::take`],
//! [`BoardImage::chip`].
//!
//! QEMU runs the processor, its interrupts, its floating point, flash and RAM. A block that it lacks reads as 0, and it logs what is
//! written there. So the stand-in ([`Chip`]) stops the processor, through QEMU's gdb stub, only before reads of registers that are not
//! 0, decodes the load and does it; other writes it takes from the log, in
//! order. Time is the stand-in's: a tick is when it says so, and as
//! long as it says, and nothing depends on how fast the emulator is.

mod board;
mod chip;
mod connection;
mod error;
mod fitted;
mod gdb;
mod loader;
mod log;
mod mutants;
mod otg;
mod processor;
mod provenance;
mod thumb;
mod unimplemented;
mod usb_host;

pub use board::Board;
pub use chip::{
    Chip, CycleCounter, EXTI0, Feeds, ID, LOADER, Lines, OTG_FS, Outputs, RANDOM, TIM7_CR1, TIM8,
    reset,
};
pub use error::BoardImageError;
pub use fitted::Fitted;
pub use loader::LoaderStart;
pub use mutants::{default_mutants, switch_of};
pub use otg::Otg;
pub use provenance::{Provenance, default_image, default_selftest, provenance};
pub use usb_host::Descriptors;

use chip::{GPIOB_IDR, TIM7, WWDG_CR, WWDG_WARNS};
use connection::{PC, STATUS};
use processor::{Processor, Stop};
use std::collections::VecDeque;
use std::path::PathBuf;
use std::time::{Duration, Instant};
use unimplemented::is_lacking;

/// Interrupt set-enable registers, set-pending registers, and the one with the NMI's bit.
const NVIC_ISER: u32 = 0xE000_E100;
const NVIC_ISPR: u32 = 0xE000_E200;
/// ... and those that mask.
const NVIC_ICER: u32 = 0xE000_E180;
const ICSR: u32 = 0xE000_ED04;
const NMI_PENDING: u32 = 1 << 31;
/// SysTick's control register.
const SYST_CSR: u32 = 0xE000_E010;
/// Counter of the grip's timer.
const TIM5_CNT: u32 = 0x4000_0C24;
/// With `-icount shift=3`.
const NS_PER_INSTRUCTION: u32 = 8;
/// Lines of the external interrupts, which QEMU has: unmasked, and on a rising edge.
const EXTI_IMR: u32 = 0x4001_3C00;
const EXTI_RTSR: u32 = 0x4001_3C08;
/// The supply detector's line.
const SUPPLY_LINE: u32 = 1 << 16;

/// Interrupts in a row without an effect, after which the image must have masked them.
const WITHOUT_EFFECT: u32 = 2;
/// Interrupts at a time, after which something is wrong.
const MOST_INTERRUPTS: u32 = 2000;
/// Bytes of a packet.
const PACKET: usize = 64;
/// Number of the exception that is handled, of the status word: 0 in the thread.
const EXCEPTION: u32 = 0x1FF;
/// The link task's handler.
const LINK_TASK: &str = "OTG_FS";
/// What begins a critical section, `cpsid i`, and instructions of the link task in which it comes.
const INTERRUPTS_OFF: u16 = 0xB672;
const UNTIL_OFF: usize = 2000;
/// Where the chip has no memory.
pub const ASTRAY: u32 = 0x1000_0000 + 0x10_0000;

/// The register and the bit that pend an interrupt.
fn pending(number: u8) -> (u32, u32) {
    (NVIC_ISPR + 4 * (u32::from(number) / 32), 1 << (number % 32))
}

/// The image, at rest between two interrupts.
#[derive(Debug)]
pub struct BoardImage {
    image: PathBuf,
    processor: Processor,
    chip: Chip,
    /// Registers of the thread while it waits.
    thread: Vec<u32>,
    up: Vec<u8>,
    /// Packets for the serial port that it has not taken.
    down: VecDeque<Vec<u8>>,
    /// Bytes of a packet on the control endpoint.
    control_size: usize,
    /// The register that lets in what is kept masked.
    kept_masked: Option<u32>,
    ticks: u64,
    /// The emulator's clock, as it was last looked at \[ns\].
    counted_ns: u32,
    started: Instant,
}

impl BoardImage {
    /// Gives the chip its supply, with everything well around it, and boots. On Linux the calling thread, and the emulator with it,
    /// stays from then on the core where it is.
    ///
    /// # Errors
    /// [`BoardImageError`].
    pub fn start(
        board: Board,
        image: PathBuf,
        time_limit: Duration,
    ) -> Result<BoardImage, BoardImageError> {
        let mut running = BoardImage::power_up(board, image, time_limit)?;
        running.boot()?;
        Ok(running)
    }

    /// Gives the chip its supply. It stands before the image's first instruction: [`BoardImage::boot`].
    ///
    /// # Errors
    /// [`BoardImageError`].
    pub fn power_up(
        board: Board,
        image: PathBuf,
        time_limit: Duration,
    ) -> Result<BoardImage, BoardImageError> {
        let processor = Processor::start(image.clone(), false, time_limit)?;
        Ok(BoardImage::of(board, image, processor))
    }

    /// The same with every instruction counted, by the emulator's own clock: [`BoardImage::instructions`]. Slower.
    ///
    /// # Errors
    /// [`BoardImageError`].
    pub fn power_up_counting(
        board: Board,
        image: PathBuf,
        time_limit: Duration,
    ) -> Result<BoardImage, BoardImageError> {
        let processor = Processor::start(image.clone(), true, time_limit)?;
        Ok(BoardImage::of(board, image, processor))
    }

    fn of(board: Board, image: PathBuf, processor: Processor) -> BoardImage {
        BoardImage {
            image,
            processor,
            chip: Chip::new(board),
            thread: Vec::new(),
            up: Vec::new(),
            down: VecDeque::new(),
            control_size: 0,
            kept_masked: None,
            ticks: 0,
            counted_ns: 0,
            started: Instant::now(),
        }
    }

    /// Before the first boot: puts everything on the board that there is a driver for.
    ///
    /// # Errors
    /// [`BoardImageError`].
    pub fn fit(&mut self) -> Result<(), BoardImageError> {
        self.chip.fitted = Some(Fitted::WELL);
        self.processor
            .connection
            .watch_writes(fitted::SPI3_DR, true)
    }

    /// From the reset vector to idle, with a first tick: its interrupt is raised where its timer starts.
    ///
    /// # Errors
    /// [`BoardImageError::Reset`] if the image resets the chip, or a watchdog does, and others.
    pub fn boot(&mut self) -> Result<(), BoardImageError> {
        self.processor.connection.watch_writes(TIM7_CR1, true)?;
        let started = self.run_to_write(TIM7_CR1);
        self.processor.connection.watch_writes(TIM7_CR1, false)?;
        self.thread = started?;
        self.chip.starts = false;
        self.begin_tick();
        // Interrupts are off: it stays pending while the start goes on.
        self.interrupt(TIM7)?;
        self.idle_feeds()
    }

    /// After [`BoardImageError::Reset`]: lets the reset happen, with its cause of [`reset`], and boots.
    ///
    /// # Errors
    /// See [`BoardImage::boot`].
    pub fn boot_again(&mut self, cause: u32) -> Result<(), BoardImageError> {
        if let Some(register) = self.kept_masked.take() {
            self.processor.connection.watch_writes(register, false)?;
        }
        self.chip.reset(cause);
        self.down.clear();
        self.up.clear();
        self.processor.reset()?;
        self.boot()
    }

    /// The chip and what is wired to it.
    pub fn chip(&mut self) -> &mut Chip {
        &mut self.chip
    }

    /// Ticks since the supply came.
    pub fn ticks(&self) -> u64 {
        self.ticks
    }

    /// Instructions since this was last asked, less than 500 million, of an image that was powered up with
    /// [`BoardImage::power_up_counting`]. A timer that the image leaves alone tells: QEMU's counts virtual nanoseconds, on or off. It
    /// would go on to the end of the emulator's SysTick whenever the processor stands; that is off, and the image never sees it.
    ///
    /// # Errors
    /// [`BoardImageError`].
    pub fn instructions(&mut self) -> Result<u32, BoardImageError> {
        self.processor.pend(&mut self.chip, SYST_CSR, 0)?;
        let now_ns = self.processor.connection.word(TIM5_CNT)?;
        let passed_ns = now_ns.wrapping_sub(self.counted_ns);
        self.counted_ns = now_ns;
        let done = std::mem::take(&mut self.processor.done);
        Ok(passed_ns / NS_PER_INSTRUCTION + done)
    }

    /// The emulator's clock, wherever the image stands \[instructions\]; differences of an image that was powered up with
    /// [`BoardImage::power_up_counting`], in which [`BoardImage::instructions`] has been asked for.
    ///
    /// # Errors
    /// [`BoardImageError`].
    pub fn instructions_so_far(&mut self) -> Result<u32, BoardImageError> {
        Ok(self.processor.connection.word(TIM5_CNT)? / NS_PER_INSTRUCTION)
    }

    /// What the run has cost: a line for people.
    pub fn speed(&self) -> String {
        let seconds = self.started.elapsed().as_secs_f64();
        format!(
            "{} ticks in {seconds:.1} s, {:.0} ticks a second, {:.1} stops a tick",
            self.ticks,
            self.ticks as f64 / seconds,
            self.processor.stops as f64 / self.ticks.max(1) as f64
        )
    }

    /// One tick: what the host has sent goes down, the tick timer's interrupt comes, what the console says goes up, and idle has its
    /// turn.
    ///
    /// # Errors
    /// [`BoardImageError::Reset`] if the image resets the chip, and others.
    pub fn tick(&mut self) -> Result<(), BoardImageError> {
        self.serve()?;
        self.begin_tick();
        self.interrupt(TIM7)?;
        self.serve()?;
        self.idle_feeds()
    }

    /// Sends bytes to the console's serial port, as fast as it takes them.
    pub fn send(&mut self, bytes: &[u8]) {
        self.down.extend(bytes.chunks(PACKET).map(<[u8]>::to_vec));
    }

    /// Packets that the console has not taken yet.
    pub fn waiting(&self) -> usize {
        self.down.len()
    }

    /// Takes what the console has sent.
    pub fn take(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.up)
    }

    /// Raises an interrupt, and lets the image run until it is at rest again.
    ///
    /// # Errors
    /// [`BoardImageError::Reset`] if the image resets the chip, and others.
    pub fn interrupt(&mut self, number: u8) -> Result<(), BoardImageError> {
        let (register, bit) = pending(number);
        self.processor.pend(&mut self.chip, register, bit)
    }

    /// Raises the interrupt of the supply's detector; false if the image has not asked for it.
    ///
    /// # Errors
    /// See [`BoardImage::interrupt`].
    pub fn supply_interrupt(&mut self) -> Result<bool, BoardImageError> {
        let lines = self.processor.connection.word(EXTI_IMR)?
            & self.processor.connection.word(EXTI_RTSR)?;
        let asked = lines & SUPPLY_LINE != 0;
        if asked {
            self.interrupt(chip::PVD)?;
        }
        Ok(asked)
    }

    /// The crystal ends, and the chip raises an NMI if the image has asked to be told; false if not.
    ///
    /// # Errors
    /// See [`BoardImage::interrupt`].
    pub fn lose_crystal(&mut self) -> Result<bool, BoardImageError> {
        let guarded = self.chip.lose_crystal();
        if guarded {
            self.processor.pend(&mut self.chip, ICSR, NMI_PENDING)?;
        }
        Ok(guarded)
    }

    /// Raises the window watchdog's early interrupt; false if the image has not asked for it.
    ///
    /// # Errors
    /// See [`BoardImage::interrupt`].
    pub fn window_watchdog(&mut self) -> Result<bool, BoardImageError> {
        let asked = self.chip.stored(WWDG_WARNS.0) & WWDG_WARNS.1 != 0;
        if asked {
            self.interrupt(chip::WWDG)?;
        }
        Ok(asked)
    }

    /// Begins a tick, and leaves the control task where it has read all but whether the amplifiers are ready: they have to be.
    ///
    /// # Errors
    /// See [`BoardImage::interrupt`].
    pub fn begin_and_stand(&mut self) -> Result<(), BoardImageError> {
        self.serve()?;
        self.begin_tick();
        let (register, bit) = pending(TIM7);
        self.processor
            .pend_to_read(&mut self.chip, (register, bit), GPIOB_IDR)
    }

    /// After [`BoardImage::begin_and_stand`]: the rest of that task, and of those that it has begun.
    ///
    /// # Errors
    /// See [`BoardImage::interrupt`].
    pub fn go_on(&mut self) -> Result<(), BoardImageError> {
        self.processor.go_on_to_rest(&mut self.chip)
    }

    /// Begins the link task and leaves it at its first instruction, above telemetry and idle: it hangs, and goes round in the waiting room.
    ///
    /// # Errors
    /// See [`BoardImage::interrupt`].
    pub fn hang_link(&mut self) -> Result<(), BoardImageError> {
        self.serve()?;
        let image = std::fs::read(&self.image).unwrap_or_default();
        let place =
            mutants::symbol(&image, LINK_TASK).ok_or_else(|| BoardImageError::NoSymbol {
                path: self.image.clone(),
                name: LINK_TASK,
            })?;
        self.processor
            .pend_to_place(&mut self.chip, pending(OTG_FS), place & !1)
    }

    /// Begins the link task and leaves it in its first critical section, where it hangs: nobody lets an interrupt in any more. Slow.
    ///
    /// # Errors
    /// [`BoardImageError::Circles`] if it has none, and others.
    pub fn hang_with_interrupts_off(&mut self) -> Result<(), BoardImageError> {
        self.hang_link()?;
        self.processor
            .step_past(&mut self.chip, INTERRUPTS_OFF, UNTIL_OFF)
    }

    /// The tick timer's interrupt with what it brings about, and nothing else: for images in which a task below it hangs.
    ///
    /// # Errors
    /// See [`BoardImage::interrupt`].
    pub fn tick_alone(&mut self) -> Result<(), BoardImageError> {
        self.begin_tick();
        self.interrupt(TIM7)
    }

    /// A tick in which idle has no turn, so that nobody is fed: for images in which a task hangs.
    ///
    /// # Errors
    /// See [`BoardImage::interrupt`].
    pub fn tick_without_idle(&mut self) -> Result<(), BoardImageError> {
        self.serve()?;
        self.begin_tick();
        self.interrupt(TIM7)?;
        self.serve()
    }

    /// Masks an interrupt, as if its task hung.
    ///
    /// # Errors
    /// See [`BoardImage::interrupt`].
    pub fn mask(&mut self, number: u8) -> Result<(), BoardImageError> {
        let (register, bit) = pending(number);
        let register = register - NVIC_ISPR + NVIC_ICER;
        self.processor.pend(&mut self.chip, register, bit)
    }

    /// Masks an interrupt until the next boot, whatever the image does to let it in again.
    ///
    /// # Errors
    /// See [`BoardImage::interrupt`].
    pub fn mask_for_good(&mut self, number: u8) -> Result<(), BoardImageError> {
        self.mask(number)?;
        let register = NVIC_ISER + 4 * (u32::from(number) / 32);
        // Watched, a write ends in the stand-in.
        self.processor.connection.watch_writes(register, true)?;
        self.kept_masked = Some(register);
        Ok(())
    }

    /// Has the thread go on where there is nothing to run.
    ///
    /// # Errors
    /// [`BoardImageError::Reset`] if the image resets the chip, and others.
    pub fn run_astray(&mut self) -> Result<(), BoardImageError> {
        self.processor.put_registers(&[(PC, ASTRAY)]);
        match self.processor.run(&mut self.chip, None)? {
            Stop::Seat => Ok(()),
            _ => Err(BoardImageError::Reset),
        }
    }

    /// Serves what the chip asks for, and carries packets both ways, until nothing more happens.
    ///
    /// # Errors
    /// See [`BoardImage::interrupt`].
    pub fn serve(&mut self) -> Result<(), BoardImageError> {
        let mut without_effect = 0;
        for _ in 0..MOST_INTERRUPTS {
            self.carry();
            let Some(number) = self.chip.interrupts().next() else {
                return Ok(());
            };
            let stops = self.processor.stops;
            self.interrupt(number)?;
            let had_effect = self.processor.stops != stops;
            without_effect = if had_effect { 0 } else { without_effect + 1 };
            if without_effect >= WITHOUT_EFFECT {
                return if self.is_unmasked(number)? {
                    Err(BoardImageError::Storm { number })
                } else {
                    Ok(())
                };
            }
        }
        let waiting = self.chip.usb.waiting();
        Err(BoardImageError::Usb(format!(
            "{MOST_INTERRUPTS} interrupts have not served what is there; {waiting} entries are in the receive FIFO"
        )))
    }

    /// Lets idle do so many instructions, without interrupts. Slow: the emulator forgets its translations at every step.
    ///
    /// # Errors
    /// [`BoardImageError`].
    pub fn idle_steps(&mut self, count: usize) -> Result<(), BoardImageError> {
        self.resume_thread();
        // A step would stop before such a write for ever.
        self.processor.connection.watch_writes(WWDG_CR, false)?;
        for _ in 0..count {
            self.processor.step(&mut self.chip)?;
        }
        self.processor.connection.watch_writes(WWDG_CR, true)?;
        self.thread = self.processor.connection.registers()?;
        Ok(())
    }

    /// Lets idle run until it has fed the watchdogs, of which the window watchdog comes last: as every task has ticked, in its next round.
    fn idle_feeds(&mut self) -> Result<(), BoardImageError> {
        self.resume_thread();
        loop {
            let registers = self.run_to_write(WWDG_CR)?;
            if registers[STATUS] & EXCEPTION == 0 {
                self.thread = registers;
                return Ok(());
            }
            // A task's, in an image that may do so.
            self.processor.put_registers_after(&registers);
        }
    }

    /// Whether the image lets an interrupt in.
    ///
    /// # Errors
    /// [`BoardImageError`].
    pub fn is_unmasked(&mut self, number: u8) -> Result<bool, BoardImageError> {
        let register = NVIC_ISER + 4 * (u32::from(number) / 32);
        let word = self.processor.connection.word(register)?;
        Ok(word & 1 << (number % 32) != 0)
    }

    /// Word of a register, be it the stand-in's or the emulator's.
    ///
    /// # Errors
    /// [`BoardImageError`].
    pub fn register(&mut self, address: u32) -> Result<u32, BoardImageError> {
        if is_lacking(address) {
            Ok(self.chip.peek(address))
        } else {
            self.processor.connection.word(address)
        }
    }

    fn begin_tick(&mut self) {
        self.chip.begin_tick();
        self.ticks += 1;
    }

    /// Packets both ways, as far as the device takes and has any.
    fn carry(&mut self) {
        let usb = &mut self.chip.usb;
        while let Some(packet) = self.down.front()
            && usb.give(usb_host::SERIAL_DOWN, otg::Down::Data, packet)
        {
            self.down.pop_front();
        }
        if let Some(packet) = usb.take(usb_host::SERIAL_UP) {
            self.up.extend(packet);
        }
    }

    /// Runs until this register has been written; the thread's registers after that.
    fn run_to_write(&mut self, register: u32) -> Result<Vec<u32>, BoardImageError> {
        match self.processor.run(&mut self.chip, Some(register))? {
            Stop::Write(address) if address == register => self.processor.access(&mut self.chip),
            Stop::Write(_) => Err(BoardImageError::Reset),
            stop => Err(self.processor.unexpected(stop)),
        }
    }

    /// Puts back what waiting took of the thread's registers.
    fn resume_thread(&mut self) {
        let thread = &self.thread;
        let of = |number: usize| (number, thread.get(number).copied().unwrap_or(0));
        self.processor.put_registers(&[0, 1, PC].map(of));
    }
}
