//! The registers of an STM32F405 or F446 that QEMU does not have, as far as the images of the boards use them (RM0090, RM0390).
//!
//! Entry points for the image: [`Chip::read`], [`Chip::write`]; for what is wired to the chip: [`Chip::lines`], [`Chip::outputs`],
//! [`Chip::open_stop`]. A register without a meaning of its own keeps what is written.

use super::board::Board;
use super::fitted::Fitted;
use super::otg::{OTG, Otg};
use std::collections::{BTreeMap, BTreeSet};

const TIM2_CNT: u32 = 0x4000_0024;
const TIM3_CNT: u32 = 0x4000_0424;
const TIM4_CNT: u32 = 0x4000_0824;
/// Control register of the tick timer: that it starts is the last thing that starting the board does.
pub const TIM7_CR1: u32 = 0x4000_1400;
const TIM7_SR: u32 = 0x4000_1410;
const TIM7_CNT: u32 = 0x4000_1424;
/// Control register of the window watchdog.
pub const WWDG_CR: u32 = 0x4000_2C00;
/// Configuration register of the window watchdog, and that it warns.
pub const WWDG_WARNS: (u32, u32) = (0x4000_2C04, 1 << 9);
const IWDG_KR: u32 = 0x4000_3000;
const PWR_CSR: u32 = 0x4000_7004;
/// First control register of the timer that has enable.
const TIM1: u32 = 0x4001_0000;
const TIM1_DIER: u32 = 0x4001_000C;
const TIM1_SR: u32 = 0x4001_0010;
const TIM1_CCMR1: u32 = 0x4001_0018;
const TIM1_CCER: u32 = 0x4001_0020;
const TIM1_BDTR: u32 = 0x4001_0044;
/// First control register of the pulses' timer.
pub const TIM8: u32 = 0x4001_0400;
const TIM8_CCER: u32 = 0x4001_0420;
const TIM8_CCR1: u32 = 0x4001_0434;
const TIM8_BDTR: u32 = 0x4001_0444;
const GPIOA_IDR: u32 = 0x4002_0010;
/// Alternate functions of pins 0 to 7 of port A.
const GPIOA_AFRL: u32 = 0x4002_0020;
/// Levels of port B: the ready line.
pub const GPIOB_IDR: u32 = 0x4002_0410;
const GPIOC_BSRR: u32 = 0x4002_0818;
const GPIOE_IDR: u32 = 0x4002_1010;
const RCC_CR: u32 = 0x4002_3800;
const RCC_PLLCFGR: u32 = 0x4002_3804;
const RCC_CFGR: u32 = 0x4002_3808;
const RCC_CSR: u32 = 0x4002_3874;
const FLASH_OPTCR: u32 = 0x4002_3C14;
const RNG_SR: u32 = 0x5006_0804;
const RNG_DR: u32 = 0x5006_0808;
const CHIP_ID: u32 = 0x1FFF_7A10;
const SYST_CVR: u32 = 0xE000_E018;
/// The core's cycle counter.
const DWT_CYCCNT: u32 = 0xE000_1004;
/// Application interrupt and reset control.
pub const AIRCR: u32 = 0xE000_ED0C;

const HSE_ON: u32 = 1 << 16;
const PLL_ON: u32 = 1 << 24;
const PLL_READY: u32 = 1 << 25;
/// Key, and the request, of a reset by software.
pub const RESET_REQUEST: u32 = 0x05FA_0004;

/// Interrupt numbers (RM0090, table 61): of the window watchdog,
pub const WWDG: u8 = 0;
/// of the supply's detector,
pub const PVD: u8 = 1;
/// of the line that telemetry runs on,
pub const EXTI0: u8 = 6;
/// of the break input,
const TIM1_BREAK: u8 = 24;
/// of the tick timer,
pub const TIM7: u8 = 55;
/// of the USB core.
pub const OTG_FS: u8 = 67;

/// Flags of RCC_CSR.
pub mod reset {
    /// The pin, which every other cause pulls, too.
    pub const PIN: u32 = 1 << 26;
    /// Power-up, with the brown-out flag.
    pub const POWER: u32 = 1 << 27 | 1 << 25 | PIN;
    /// By software.
    pub const SOFTWARE: u32 = 1 << 28 | PIN;
    /// By the independent watchdog.
    pub const INDEPENDENT_WATCHDOG: u32 = 1 << 29 | PIN;
    /// By the window watchdog.
    pub const WINDOW_WATCHDOG: u32 = 1 << 30 | PIN;
}

/// The loader in the chip's ROM.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RomLoader {
    /// Its vector table.
    pub table: u32,
    /// Its stack, and its first instruction: made up, the manuals have neither.
    pub stack: u32,
    /// As above.
    pub entry: u32,
    /// What maps memories to address 0 (SYSCFG_MEMRMP; QEMU forgets it).
    pub map: u32,
}

/// The loader in the chip's ROM (ST AN2606: system memory).
pub const LOADER: RomLoader = RomLoader {
    table: 0x1FFF_0000,
    stack: 0x2000_2D40,
    entry: 0x1FFF_1234,
    map: 0x4001_3800,
};

/// What the seed of session numbers is drawn as.
pub const RANDOM: u32 = 0xC0FF_EE01;
/// The chip's own number, 96 bits.
pub const ID: [u32; 3] = [0x0043_002B, 0x3438_510B, 0x3236_3530];

/// What the core's cycle counter does, which a debugger may switch off, on, or set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CycleCounter {
    /// It stands at 0. QEMU has no other.
    Stands,
    /// It is so many cycles on at every reading, round its 32 bits; a tick has 168,000.
    Moves(u32),
    /// It is anything at every reading, forwards or back, in an order that is always the same.
    Jumps,
}

/// What is wired to the chip.
#[derive(Clone, Copy, Debug)]
pub struct Lines {
    /// Encoder counters, (3).
    pub encoder_counts: [i32; 3],
    /// The amplifiers' ready line.
    pub ready: bool,
    /// The supply is below the detector's threshold.
    pub supply_low: bool,
    /// The crystal swings.
    pub crystal: bool,
    /// Counts of SysTick in a period of the tick timer: 21000 where the clocks agree.
    pub systick_per_tick: u32,
    /// The core's cycle counter.
    pub cycle_counter: CycleCounter,
    /// Every tick ends after the next one was due.
    pub ticks_late: bool,
    /// The self-test's jumpers are in: PC6 to A and PC7 to B of all encoders, PC8 to the stop's line, enable to ready.
    pub jumpers: bool,
}

/// What the chip puts out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Outputs {
    /// Amplifier enable: PA8 of the H405, PE9 of the NUCLEO.
    pub enable: bool,
    /// The pulses run, PC6 to PC8.
    pub pulses: bool,
    /// Compare values of the three motors, of 42000 counts.
    pub duty: [u32; 3],
}

/// How often each watchdog was fed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Feeds {
    /// The independent one.
    pub independent: u32,
    /// The window watchdog.
    pub window: u32,
}

/// The chip.
#[derive(Clone, Debug)]
pub struct Chip {
    board: Board,
    /// What is wired to it.
    pub lines: Lines,
    /// Its USB core.
    pub usb: Otg,
    /// What else is on the board.
    pub fitted: Option<Fitted>,
    /// Every change of the outputs since this was last taken, in order.
    pub changes: Vec<Outputs>,
    /// Since power-up.
    pub feeds: Feeds,
    /// The independent watchdog runs.
    pub watchdog_runs: bool,
    /// So does the window watchdog.
    pub window_runs: bool,
    /// The image has not come to the end of its start: every read of a block is answered here.
    pub starts: bool,
    /// The option bytes have the independent watchdog start with the chip.
    pub watchdog_by_option: bool,
    /// Brown-out level in the option bytes, `BOR_LEV`: 0 is level 3, as consoles have it; 3 is off, as chips come.
    pub brown_out: u32,
    /// Reads of the clock control while the crystal does not swing, and of the supply's detector while it finds it low, in a start.
    pub waits: u32,
    /// Number of writes so far.
    writes: u64,
    /// Number of the write that has started each timer, by its control register.
    pub started: BTreeMap<u32, u64>,
    /// The core's cycle counter, as it was last read.
    pub cycles: u32,
    stored: BTreeMap<u32, u32>,
    systick: u32,
    stop_open: bool,
    /// TIM1's break flag.
    tripped: bool,
    /// TIM7's update flag.
    tick_due: bool,
    /// Levels of port C that the program has set, where jumpers lead on.
    levels: u32,
    shown: Outputs,
}

const DARK: Outputs = Outputs {
    enable: false,
    pulses: false,
    duty: [0; 3],
};

impl Chip {
    /// A chip that has just got its supply, with everything well around it.
    pub fn new(board: Board) -> Chip {
        let lines = Lines {
            encoder_counts: [0; 3],
            ready: true,
            supply_low: false,
            crystal: true,
            systick_per_tick: 21_000,
            cycle_counter: CycleCounter::Stands,
            ticks_late: false,
            jumpers: false,
        };
        let mut chip = Chip {
            board,
            lines,
            usb: Otg::new(board.usb_core()),
            fitted: None,
            changes: Vec::new(),
            feeds: Feeds::default(),
            watchdog_runs: false,
            window_runs: false,
            starts: true,
            watchdog_by_option: false,
            brown_out: 0,
            waits: 0,
            writes: 0,
            started: BTreeMap::new(),
            cycles: 0,
            stored: BTreeMap::new(),
            systick: 0x00FF_0000,
            stop_open: false,
            tripped: false,
            tick_due: false,
            levels: 0,
            shown: DARK,
        };
        chip.reset(reset::POWER);
        chip
    }

    /// A reset, with its flags of [`reset`]: registers start again, the encoders' counters at 0; lines stay.
    pub fn reset(&mut self, cause: u32) {
        self.lines.encoder_counts = [0; 3];
        self.usb = Otg::new(self.board.usb_core());
        self.stored.clear();
        self.starts = true;
        self.watchdog_runs = self.watchdog_by_option;
        self.window_runs = false;
        self.waits = 0;
        self.tripped = false;
        self.tick_due = false;
        self.levels = 0;
        // Values after a reset that are not 0 and that the image builds on (RM0090, 7.3, 8.4.11; brown-out level 3 in the options).
        self.stored.extend([
            (RCC_CR, 0x83),
            (RCC_CSR, cause),
            (FLASH_OPTCR, 0x0FFF_AAE1),
            (LOADER.table, LOADER.stack),
            (LOADER.table + 4, LOADER.entry | 1),
            (0x4002_0000, 0xA800_0000),
            (0x4002_000C, 0x6400_0000),
            (0x4002_0400, 0x0000_0280),
            (0x4002_040C, 0x0000_0100),
        ]);
        self.show();
    }

    /// What a read of a register gives, without what it does.
    pub fn peek(&self, address: u32) -> u32 {
        let bit = |set, at: u32| if set { 1 << at } else { 0 };
        let counts = |joint: usize| self.lines.encoder_counts[joint] as u32;
        if let Some(value) = self.fitted.and_then(|fitted| fitted.peek(address)) {
            return value;
        }
        match address {
            TIM3_CNT => counts(0) & 0xFFFF,
            TIM4_CNT => counts(1) & 0xFFFF,
            TIM2_CNT => counts(2),
            TIM7_SR => bit(self.tick_due, 0),
            TIM7_CNT => 0,
            PWR_CSR => self.stored(address) & !(1 << 2) | bit(self.lines.supply_low, 2),
            // BOR_LEV, and WDG_SW (RM0090, 3.9.10).
            FLASH_OPTCR => {
                let options = self.stored(address) & !(0b11 << 2) | self.brown_out << 2;
                options & !bit(self.watchdog_by_option, 5)
            }
            TIM1_SR => bit(self.tripped, 7),
            GPIOA_IDR => bit(!self.stop_open, 6) | bit(self.shows_enable(address), 8),
            GPIOB_IDR if self.lines.jumpers => bit(self.outputs().enable, 9),
            GPIOB_IDR => bit(self.lines.ready, 9),
            GPIOE_IDR => bit(self.shows_enable(address), 9),
            RCC_CR => self.oscillators(),
            // The switch obeys at once; a PLL that has lost its crystal gives way to the internal oscillator (RM0090, 7.2.7).
            RCC_CFGR => {
                let runs = self.oscillators() & PLL_READY != 0;
                let from = if runs { self.stored(address) & 3 } else { 0 };
                self.stored(address) & !0xC | from << 2
            }
            RNG_SR if self.board.draws() => 1,
            RNG_DR if self.board.draws() => RANDOM,
            CHIP_ID..0x1FFF_7A1C => ID[(address - CHIP_ID) as usize / 4],
            SYST_CVR => self.systick,
            DWT_CYCCNT => self.cycles,
            OTG..0x5004_0000 => self.usb.peek(address - OTG),
            _ => self.stored(address),
        }
    }

    /// A read of a register.
    pub fn read(&mut self, address: u32) -> u32 {
        match address {
            OTG..0x5004_0000 => return self.usb.read(address - OTG),
            RCC_CR if self.stored(RCC_CR) & HSE_ON != 0 && !self.lines.crystal => {
                self.waits += 1;
            }
            PWR_CSR if self.starts && self.lines.supply_low => self.waits += 1,
            DWT_CYCCNT => {
                self.cycles = match self.lines.cycle_counter {
                    CycleCounter::Stands => 0,
                    CycleCounter::Moves(by) => self.cycles.wrapping_add(by),
                    // Knuth's linear congruential generator, all 2^32 numbers of it.
                    CycleCounter::Jumps => self
                        .cycles
                        .wrapping_mul(1_664_525)
                        .wrapping_add(1_013_904_223),
                };
            }
            _ => {}
        }
        self.peek(address)
    }

    /// A write to a register.
    pub fn write(&mut self, address: u32, value: u32) {
        if let Some(fitted) = &mut self.fitted {
            fitted.write(address, value, self.lines.encoder_counts[2]);
        }
        self.writes += 1;
        match address {
            OTG..0x5004_0000 => return self.usb.write(address - OTG, value),
            TIM7_CR1 | TIM8 if value & 1 != 0 => {
                self.started.insert(address, self.writes);
            }
            TIM7_SR => self.tick_due = self.lines.ticks_late,
            // Cleared by writing 0; an open line sets it again.
            TIM1_SR => {
                self.tripped &= value & 1 << 7 != 0 || self.breaks(self.stored(TIM1_BDTR));
            }
            IWDG_KR => match value {
                0xAAAA => self.feeds.independent += 1,
                0xCCCC => self.watchdog_runs = true,
                _ => {}
            },
            WWDG_CR => {
                self.feeds.window += 1;
                self.window_runs |= value & 1 << 7 != 0;
            }
            GPIOC_BSRR if self.lines.jumpers => self.jump(value),
            // Remove the reset flags.
            RCC_CSR if value & 1 << 24 != 0 => {
                self.stored.insert(RCC_CSR, 0);
                return;
            }
            TIM1_BDTR if self.breaks(value) => {
                self.tripped = true;
                self.stored.insert(address, value & !(1 << 15));
                self.show();
                return;
            }
            _ => {}
        }
        self.stored.insert(address, value);
        if [TIM1, TIM8].contains(&(address & !0xFF)) {
            self.show();
        }
    }

    /// What a read gave 0 for although it is not 0: the runner has to watch it. Only for registers that change by themselves.
    pub fn misread(&self, address: u32) -> bool {
        self.alive().contains(&address) && self.peek(address) != 0
    }

    /// Registers that have to be watched for reads now: address and length.
    pub fn watched(&self) -> BTreeSet<(u32, u32)> {
        let mut watched =
            BTreeSet::from([(SYST_CVR, 4), (TIM2_CNT, 4), (TIM3_CNT, 4), (TIM4_CNT, 4)]);
        if self.lines.cycle_counter != CycleCounter::Stands {
            watched.insert((DWT_CYCCNT, 4));
        }
        if self.starts {
            watched.extend([
                (TIM7_CR1, 0x30),
                (PWR_CSR - 4, 8),
                (TIM1, 0x50),
                (TIM8, 0x50),
                (0x4002_0000, 0x28),
                (0x4002_0400, 0x28),
                (0x4002_0800, 0x28),
                (0x4002_0C00, 0x28),
                (0x4002_1000, 0x28),
                (0x4002_1800, 0x28),
                (RCC_CR, 0x98),
                (FLASH_OPTCR - 0x14, 0x18),
                (RNG_SR - 4, 12),
                (CHIP_ID, 12),
                (LOADER.table, 8),
            ]);
        } else {
            let alive = self.alive().into_iter();
            // What the program sets comes back by a jumper before anything else stops it.
            let live = alive.filter(|at| self.lines.jumpers || self.peek(*at) != 0);
            watched.extend(live.map(|at| (at, 4)));
            let fitted = self.fitted.iter().flat_map(|_| Fitted::WATCHED);
            watched.extend(fitted.map(|at| (at, 4)));
        }
        if self.starts || self.usb.sets_up {
            watched.insert((OTG, 0xF00));
            let fifo = self
                .usb
                .watched()
                .into_iter()
                .filter(|offset| *offset >= 0xF00);
            watched.extend(fifo.map(|offset| (OTG + offset, 4)));
        } else {
            watched.extend(
                self.usb
                    .watched()
                    .into_iter()
                    .map(|offset| (OTG + offset, 4)),
            );
        }
        watched
    }

    /// What the outputs are.
    pub fn outputs(&self) -> Outputs {
        let is_on = |control| self.stored(control) & 1 << 15 != 0;
        Outputs {
            // Its channel on and not turned round (CC1E, CC1P), and forced active (OC1M = 101).
            enable: is_on(TIM1_BDTR)
                && self.stored(TIM1_CCER) & 0b11 == 0b01
                && self.stored(TIM1_CCMR1) >> 4 & 7 == 0b101,
            pulses: is_on(TIM8_BDTR) && self.stored(TIM8_CCER) & 0x111 == 0x111,
            duty: [0, 4, 8].map(|at| self.stored(TIM8_CCR1 + at)),
        }
    }

    /// The emergency stop's line opens. TIM1 takes its output away, whatever the program does (RM0090, 17.3.12).
    pub fn open_stop(&mut self) {
        self.stop_open = true;
        if self.breaks(self.stored(TIM1_BDTR)) {
            self.trip();
        }
    }

    /// The emergency stop's line is closed again. Outputs come back when the program says so.
    pub fn close_stop(&mut self) {
        self.stop_open = false;
    }

    /// The crystal ends. Where the program has asked for it the chip trips the break input; true if it raises an NMI, too.
    pub fn lose_crystal(&mut self) -> bool {
        self.lines.crystal = false;
        let guarded = self.stored(RCC_CR) & 1 << 19 != 0;
        if guarded && has_break(self.stored(TIM1_BDTR)) {
            self.trip();
        }
        guarded
    }

    /// A period of the tick timer begins.
    pub fn begin_tick(&mut self) {
        self.tick_due = true;
        self.systick = self.systick.wrapping_sub(self.lines.systick_per_tick) & 0x00FF_FFFF;
    }

    /// Interrupts that the chip asks for now, by level.
    pub fn interrupts(&self) -> impl Iterator<Item = u8> {
        let stop = self.tripped && self.stored(TIM1_DIER) & 1 << 7 != 0;
        let lines = [(stop, TIM1_BREAK), (self.usb.interrupts_now(), OTG_FS)];
        lines
            .into_iter()
            .filter_map(|(asks, number)| asks.then_some(number))
    }

    /// What a register of the pins or timers was last set to.
    pub fn stored(&self, address: u32) -> u32 {
        self.stored.get(&address).copied().unwrap_or(0)
    }

    /// Registers that change by themselves once the image has started, USB apart.
    fn alive(&self) -> [u32; 7] {
        [
            GPIOA_IDR, GPIOB_IDR, GPIOE_IDR, PWR_CSR, TIM1_SR, TIM7_SR, RCC_CFGR,
        ]
    }

    /// Levels of port C change: what the jumpers make of them. An encoder counts up where A leads B (RM0090, 18.3.12).
    fn jump(&mut self, value: u32) {
        let quarter = |levels: u32| match levels >> 6 & 3 {
            0b00 => 0,
            0b01 => 1,
            0b11 => 2,
            _ => 3,
        };
        let before = self.levels;
        self.levels = before & !(value >> 16) | value & 0xFFFF;
        let step = (quarter(self.levels) - quarter(before) + 1_i32).rem_euclid(4) - 1;
        for counts in &mut self.lines.encoder_counts {
            // Two lines at once are no step that can be told.
            *counts += if step.abs() == 1 { step } else { 0 };
        }
        match self.levels >> 8 & 1 {
            0 => self.open_stop(),
            _ => self.close_stop(),
        }
    }

    /// Whether enable is to be read at this port: where the self-test's jumpers are, on the board's own pin.
    fn shows_enable(&self, port: u32) -> bool {
        self.lines.jumpers && self.board.enable_port() == port && self.outputs().enable
    }

    /// Whether TIM1 with this break and dead-time register is held by the stop's line, which comes in by PA6's alternate function 1.
    fn breaks(&self, control: u32) -> bool {
        self.stop_open && has_break(control) && self.stored(GPIOA_AFRL) >> 24 & 0xF == 1
    }

    /// TIM1's break.
    fn trip(&mut self) {
        self.tripped = true;
        let control = self.stored(TIM1_BDTR);
        self.stored.insert(TIM1_BDTR, control & !(1 << 15));
        self.show();
    }

    fn show(&mut self) {
        let outputs = self.outputs();
        if outputs != self.shown {
            self.shown = outputs;
            self.changes.push(outputs);
        }
    }

    fn oscillators(&self) -> u32 {
        let value = self.stored(RCC_CR);
        let crystal = value & HSE_ON != 0 && self.lines.crystal;
        // The PLL's source (PLLCFGR, PLLSRC).
        let from_internal = self.stored(RCC_PLLCFGR) & 1 << 22 == 0;
        let bit = |set, at: u32| if set { 1 << at } else { 0 };
        value & !(1 << 17 | 1 << 25)
            | bit(crystal, 17)
            | bit(value & PLL_ON != 0 && (crystal || from_internal), 25)
            | 1 << 1
    }
}

/// Break enabled (BKE), active low (BKP).
fn has_break(control: u32) -> bool {
    control & 0b11 << 12 == 1 << 12
}

#[cfg(test)]
mod tests;
