//! What the image makes of the chip's pins, its motor timer and its supply detector, as their registers have it once a board has started.

use super::{Board, On};
use sutura_hil::board_image::{Chip, TIM7_CR1, TIM8};

/// Ports that an image sets up, and where their registers begin.
const PORTS: [(char, u32); 6] = [
    ('A', 0x4002_0000),
    ('B', 0x4002_0400),
    ('C', 0x4002_0800),
    ('D', 0x4002_0C00),
    ('E', 0x4002_1000),
    ('G', 0x4002_1800),
];
/// Registers of a port (RM0090, 8.4): mode, pull resistors, alternate functions of pins 0 to 7 and of the others.
const MODER: u32 = 0x00;
const PUPDR: u32 = 0x0C;
const AFR: [u32; 2] = [0x20, 0x24];
const PWR_CR: u32 = 0x4000_7000;
const TIM8_PSC: u32 = 0x4001_0428;
const TIM8_ARR: u32 = 0x4001_042C;
/// Break and dead-time register of the timer that has enable.
const TIM1_BDTR: u32 = 0x4001_0044;
const TIM8_BDTR: u32 = 0x4001_0444;

/// A pin's mode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Pin {
    /// As after a reset: an input, floating.
    Left,
    /// An input with a resistor to ground.
    Down,
    Out,
    Analog,
    /// An alternate function, without resistors.
    Timer(u32),
    /// ... with one to ground.
    TimerDown(u32),
    /// A debugger's, as after a reset.
    Debug,
}

/// Pins that a board uses, by their names.
fn used(board: Board) -> Vec<(&'static str, Pin)> {
    use Pin::{Analog, Debug, Down, Out, Timer, TimerDown};
    let mut used = vec![
        ("C6", Timer(3)),
        ("C7", Timer(3)),
        ("C8", Timer(3)),
        ("A6", TimerDown(1)),
        ("B9", Down),
        ("A11", Timer(10)),
        ("A12", Timer(10)),
        ("A13", Debug),
        ("A14", Debug),
    ];
    used.extend(match board {
        Board::OLIMEX_H405 => vec![
            ("B4", Timer(2)),
            ("A7", Timer(2)),
            ("B6", Timer(2)),
            ("B7", Timer(2)),
            ("A15", Timer(1)),
            ("B3", Timer(1)),
            ("A8", Timer(1)),
            ("C12", Out),
        ],
        Board::NUCLEO_F446ZE => vec![
            ("B4", Timer(2)),
            ("B5", Timer(2)),
            ("D12", Timer(2)),
            ("D13", Timer(2)),
            ("A15", Timer(1)),
            ("A1", Timer(1)),
            ("E9", Timer(1)),
            ("B0", Out),
            ("B7", Out),
            ("B14", Out),
            ("G6", Out),
            ("C5", Analog),
            // The probe listens to it.
            ("B3", Debug),
        ],
        other => panic!("{} has no table here", other.name()),
    });
    used
}

fn found(chip: &Chip, base: u32, pin: u32) -> Pin {
    let two = |register| chip.stored(base + register) >> (2 * pin) & 0b11;
    let function = chip.stored(base + AFR[pin as usize / 8]) >> (4 * (pin % 8)) & 0xF;
    match (two(MODER), two(PUPDR), function) {
        (0b00, 0b00, _) => Pin::Left,
        (0b00, 0b10, _) => Pin::Down,
        (0b01, 0b00, _) => Pin::Out,
        (0b11, 0b00, _) => Pin::Analog,
        (0b10, 0b00, 1..) => Pin::Timer(function),
        (0b10, 0b10, 1..) => Pin::TimerDown(function),
        (0b10, _, 0) => Pin::Debug,
        (mode, pull, _) => panic!("pin {pin} at {base:#x}: mode {mode:#04b}, pull {pull:#04b}"),
    }
}

on_each_board!(pins_are_what_the_boards_table_has_and_encoders_meet_no_resistor);
/// 5 V may not meet one, and two of these have one after a reset. What is not in the table is left alone: the ROM's loader listens on
/// some of it, and drives others.
pub(super) fn pins_are_what_the_boards_table_has_and_encoders_meet_no_resistor(on: On) {
    let mut board = on.start();
    let chip = board.chip();
    let used = used(on.board);
    for (port, base) in PORTS {
        for pin in 0..16 {
            let name = format!("{port}{pin}");
            let expected = used.iter().find(|(used, _)| *used == name);
            let expected = expected.map_or(Pin::Left, |(_, expected)| *expected);
            assert_eq!(found(chip, base, pin), expected, "P{name}");
        }
    }
}

on_each_board!(the_break_input_is_on_active_low_and_locked_for_enable_and_off_for_pulses);
/// With outputs that are driven low while they are off, and lock level 2 (RM0090, 17.4.18).
fn the_break_input_is_on_active_low_and_locked_for_enable_and_off_for_pulses(on: On) {
    let mut board = on.start();
    for (register, has_break) in [(TIM1_BDTR, 1 << 12), (TIM8_BDTR, 0)] {
        let control = board.chip().stored(register);
        let [off_states, lock, enabled, active_high, automatic] =
            [0b11 << 10, 0b11 << 8, 1 << 12, 1 << 13, 1 << 14].map(|bits| control & bits);
        assert_eq!(
            (off_states, lock, enabled, active_high, automatic),
            (0b11 << 10, 0b10 << 8, has_break, 0, 0),
            "{register:#x}: {control:#x}"
        );
    }
}

on_each_board!(pulses_come_as_often_as_the_amplifier_takes_them);
/// 4 kHz of 168 MHz: an ESCON takes 10 Hz to 5 kHz.
fn pulses_come_as_often_as_the_amplifier_takes_them(on: On) {
    let mut board = on.start();
    let counts = [TIM8_PSC, TIM8_ARR].map(|register| board.chip().stored(register) + 1);
    assert_eq!(168_000_000 / (counts[0] * counts[1]), 4000, "{counts:?}");
}

on_each_board!(a_tick_comes_at_the_same_place_of_a_pulse_in_every_boot);
/// Both timers are started one right after the other, with interrupts off; their rates are in [`super::registers`].
fn a_tick_comes_at_the_same_place_of_a_pulse_in_every_boot(on: On) {
    let mut board = on.start();
    let started = &board.chip().started;
    assert_eq!(started[&TIM7_CR1], started[&TIM8] + 1, "{started:?}");
}

on_each_board!(no_interrupt_is_let_in_but_those_of_the_boards_own_tasks);
/// The framework lets in those of all boards, the emulator's serial port among them, whose pins lie open here.
fn no_interrupt_is_let_in_but_those_of_the_boards_own_tasks(on: On) {
    // RM0090, 12.1.3: window watchdog, supply, telemetry's, TIM1's break, TIM7, USB.
    const OWN: [u8; 6] = [0, 1, 6, 24, 55, 67];
    let mut board = on.start();
    let let_in: Vec<u8> = (0..96)
        .filter(|number| board.is_unmasked(*number).unwrap())
        .collect();
    assert_eq!(let_in, OWN);
}

on_each_board!(the_supply_is_watched_at_the_level_that_the_flash_needs);
/// Level 5, below 2.76 to 2.90 V: five wait states at 168 MHz need 2.7 V.
pub(super) fn the_supply_is_watched_at_the_level_that_the_flash_needs(on: On) {
    let mut board = on.start();
    let control = board.chip().stored(PWR_CR);
    assert_eq!(control >> 5 & 0b111, 5, "PLS of {control:#x}");
    assert_ne!(control & 1 << 4, 0, "PVDE of {control:#x}");
}
