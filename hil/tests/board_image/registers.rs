//! Clocks, rates, time-outs, filters and priorities of the image that runs, worked out from its registers by the manuals' formulas alone: no
//! constant of the image is used here. The book has the same table.

use super::{Bench, Board, On};
use sutura_hil::board_image::BoardImage;

/// Clock that comes in \[Hz\]: the H405's crystal, and the NUCLEO's from its probe.
const HSE_HZ: f64 = 8e6;
/// Range of the independent watchdog's oscillator \[Hz\] (DS8626 and DS10693, LSI).
const LSI_HZ: [f64; 2] = [17e3, 47e3];

const RCC: u32 = 0x4002_3800;
const FLASH_ACR: u32 = 0x4002_3C00;
const TIM2: u32 = 0x4000_0000;
const TIM3: u32 = 0x4000_0400;
const TIM4: u32 = 0x4000_0800;
const TIM7: u32 = 0x4000_1400;
const TIM8: u32 = 0x4001_0400;
const WWDG: u32 = 0x4000_2C00;
const IWDG: u32 = 0x4000_3000;
const PWR_CR: u32 = 0x4000_7000;
const ADC_CCR: u32 = 0x4001_2304;
const SYSTICK: u32 = 0xE000_E010;
const AIRCR: u32 = 0xE000_ED0C;
const NVIC_IPR: u32 = 0xE000_E400;

/// Registers of timers, by their place in the block (RM0090, 18.4 and 20.4).
const SMCR: u32 = 0x08;
const CCMR1: u32 = 0x18;
const CCER: u32 = 0x20;
const PSC: u32 = 0x28;
const ARR: u32 = 0x2C;

/// Clocks \[Hz\].
#[derive(Clone, Copy, Debug)]
struct Clocks {
    core: f64,
    usb: f64,
    apb1: f64,
    apb2: f64,
    /// Clocks of the timers on each bus: twice the bus's where that is divided (RM0090, 7.2).
    timers1: f64,
    timers2: f64,
}

fn field(word: u32, at: u32, bits: u32) -> u32 {
    word >> at & ((1 << bits) - 1)
}

/// Clocks from RCC_PLLCFGR and RCC_CFGR (RM0090, 7.3.2 and 7.3.3).
fn clocks(board: &mut BoardImage) -> Clocks {
    let pll = board.register(RCC + 0x04).unwrap();
    let cfgr = board.register(RCC + 0x08).unwrap();
    let control = board.register(RCC).unwrap();
    assert_eq!(field(pll, 22, 1), 1, "the PLL's source is the crystal");
    assert_eq!(field(cfgr, 2, 2), 0b10, "the PLL is the system clock");
    assert_eq!(field(control, 19, 1), 1, "the crystal is watched");
    let comparator = HSE_HZ / f64::from(field(pll, 0, 6));
    assert!((1e6..=2e6).contains(&comparator), "{comparator} Hz");
    let vco = comparator * f64::from(field(pll, 6, 9));
    assert!((100e6..=432e6).contains(&vco), "{vco} Hz");
    let system = vco / f64::from(2 * (field(pll, 16, 2) + 1));
    // HPRE: divided from 0b1000 on, by 2, 4, 8, 16, 64 ...
    let ahb = match field(cfgr, 4, 4) {
        0..8 => 1.0,
        other => [2.0, 4.0, 8.0, 16.0, 64.0, 128.0, 256.0, 512.0][other as usize - 8],
    };
    let core = system / ahb;
    let divided = |at: u32| match field(cfgr, at, 3) {
        0..4 => 1.0,
        other => f64::from(2 << (other - 4)),
    };
    let [by1, by2] = [divided(10), divided(13)];
    let timers = |by: f64| if by == 1.0 { core } else { 2.0 * core / by };
    Clocks {
        core,
        usb: vco / f64::from(field(pll, 24, 4)),
        apb1: core / by1,
        apb2: core / by2,
        timers1: timers(by1),
        timers2: timers(by2),
    }
}

/// Periods a second of an up-counting timer \[Hz\].
fn rate(board: &mut BoardImage, timer: u32, clock_hz: f64) -> f64 {
    let [prescaler, period] = [PSC, ARR].map(|at| board.register(timer + at).unwrap());
    clock_hz / f64::from(prescaler + 1) / f64::from(period + 1)
}

on_each_board!(every_rate_time_out_filter_and_priority_is_what_the_book_says);
pub(super) fn every_rate_time_out_filter_and_priority_is_what_the_book_says(on: On) {
    let mut bench = Bench::start(on);
    let board = &mut bench.board;
    let clocks = clocks(board);
    assert_eq!(clocks.core, 168e6);
    assert_eq!(clocks.usb, 48e6);
    assert_eq!(
        (clocks.apb1, clocks.apb2),
        (42e6, 84e6),
        "at most 42 and 84 MHz"
    );
    // Five wait states at 2.7 V and more (RM0090, table 11).
    assert!(field(board.register(FLASH_ACR).unwrap(), 0, 3) >= 5);

    assert_eq!(rate(board, TIM7, clocks.timers1), 1000.0, "ticks a second");
    let pulses = rate(board, TIM8, clocks.timers2);
    assert_eq!(pulses, 4000.0, "pulses a second");
    assert_eq!(pulses % 1000.0, 0.0, "whole pulses in a tick");

    // SysTick: an eighth of the core's clock, unless CLKSOURCE is set; 24 bits.
    let [control, reload] = [0, 4].map(|at| board.register(SYSTICK + at).unwrap());
    assert_eq!(
        field(control, 0, 3),
        0b001,
        "runs, by an eighth, without an interrupt"
    );
    let round_s = f64::from(reload + 1) / (clocks.core / 8.0);
    assert!((0.75..0.85).contains(&round_s), "goes round in {round_s} s");

    // Independent watchdog: (RLR + 1) x 4 x 2^PR of its own oscillator (RM0090, 21.4).
    let [divider, reload] = [4, 8].map(|at| board.register(IWDG + at).unwrap());
    let counts = f64::from(reload + 1) * f64::from(4 << divider);
    let bites_s = LSI_HZ.map(|hz| counts / hz);
    assert!(bites_s[0] < 0.2 && bites_s[1] > 0.06, "{bites_s:?} s");

    // Window watchdog: 4096 x 2^WDGTB x (T - 0x3F) of APB1's clock, the warning one step before (RM0090, 22.4).
    let [control, config] = [0, 4].map(|at| board.register(WWDG + at).unwrap());
    let step_s = 4096.0 * f64::from(1 << field(config, 7, 2)) / clocks.apb1;
    let bites_s = step_s * f64::from(field(control, 0, 7) - 0x3F);
    assert!((0.0495..0.0505).contains(&bites_s), "{bites_s} s");
    assert_eq!(field(config, 9, 1), 1, "warns");
    assert_eq!(field(config, 0, 7), 0x7F, "no window: fed whenever");
    assert!(round_s > 0.2, "SysTick goes round after both");

    // Encoders: both edges of both lines (SMS = 3), and a filter of so many samples (RM0090, 18.4.3 and 18.4.7).
    for (timer, whole) in [(TIM2, u32::MAX), (TIM3, 0xFFFF), (TIM4, 0xFFFF)] {
        let word = |board: &mut BoardImage, at| board.register(timer + at).unwrap();
        assert_eq!(field(word(board, SMCR), 0, 3), 0b011, "{timer:#x}: SMS");
        assert_eq!(word(board, ARR), whole, "{timer:#x}: all of the counter");
        assert_eq!(field(word(board, CCER), 0, 8) & 0b1010_1010, 0, "polarity");
        for at in [4, 12] {
            let filter = field(word(board, CCMR1), at, 4);
            // Samples by the timer's clock undivided: 1, 2, 4, 8 of it.
            let samples = [1.0, 2.0, 4.0, 8.0][filter as usize];
            let swallowed_s = samples / clocks.timers1;
            assert!((90e-9..100e-9).contains(&swallowed_s), "{swallowed_s} s");
        }
    }

    // Priorities: four bits, all of them preempt (PRIGROUP); a lower number comes first.
    assert!(
        field(board.register(AIRCR).unwrap(), 8, 3) <= 3,
        "no sub-priorities"
    );
    let priority = |board: &mut BoardImage, number: u32| {
        let word = board.register(NVIC_IPR + number / 4 * 4).unwrap();
        field(word, 8 * (number % 4), 8) >> 4
    };
    // RM0090, 12.1.3: window watchdog, supply, TIM1's break; TIM7; USB; telemetry's.
    let most = [0, 1, 24].map(|number| priority(board, number));
    let [tick, link, telemetry] = [55, 67, 6].map(|number| priority(board, number));
    assert!(most.iter().all(|each| *each == most[0]), "{most:?}");
    assert!(
        most[0] < tick && tick < link && link < telemetry,
        "{most:?} {tick} {link} {telemetry}"
    );

    // Supply detector: level 5, 2.76 to 2.90 V falling.
    assert_eq!(field(board.register(PWR_CR).unwrap(), 4, 4), 0b1011);
}

/// APB2's clock by 2, 4, 6 or 8, at most 36 MHz (DS8626 and DS10693, f_ADC). The NUCLEO has converters in use in either image.
pub(super) fn converters_run_within_their_limit(on: On) {
    let mut board = on.start();
    let by = 2.0 * f64::from(field(board.register(ADC_CCR).unwrap(), 16, 2) + 1);
    let converter = clocks(&mut board).apb2 / by;
    assert!(converter <= 36e6, "{converter} Hz");
}

#[test]
fn converters_of_the_flashed_image_run_within_their_limit() {
    converters_run_within_their_limit(On::flashed(Board::NUCLEO_F446ZE));
}
