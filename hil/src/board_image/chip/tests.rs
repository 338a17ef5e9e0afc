//! Registers as the image and the wires see them.

use super::*;

/// Set up as the board sets it up, and on.
fn armed() -> Chip {
    let mut chip = Chip::new(Board::OLIMEX_H405);
    for (address, value) in [
        // PA6 is TIM1's (AF1).
        (GPIOA_AFRL, 1 << 24),
        (TIM1_CCER, 1),
        (TIM8_CCER, 0x111),
        (TIM8_CCR1, 21_000),
        (TIM8_CCR1 + 4, 21_000),
        (TIM8_CCR1 + 8, 21_000),
        (TIM8_BDTR, 0x8E00),
        (TIM1_BDTR, 0x9E00),
        (TIM1_CCMR1, 0x50),
        (TIM1_DIER, 0x80),
    ] {
        chip.write(address, value);
    }
    chip
}

#[test]
fn the_break_takes_enable_alone_and_gives_it_back_to_nobody_while_it_stands() {
    let mut chip = armed();
    let on = Outputs {
        enable: true,
        pulses: true,
        duty: [21_000; 3],
    };
    assert_eq!(chip.outputs(), on);
    chip.open_stop();
    assert!(!chip.outputs().enable && chip.outputs().pulses);
    assert!(chip.interrupts().eq([TIM1_BREAK]));
    // Neither the output nor the flag obeys while the line is open.
    chip.write(TIM1_BDTR, 0x9E00);
    chip.write(TIM1_SR, 0);
    assert!(!chip.outputs().enable);
    assert_eq!(chip.peek(TIM1_SR), 0x80);
    chip.close_stop();
    assert!(!chip.outputs().enable, "by itself");
    chip.write(TIM1_SR, 0);
    assert_eq!(chip.peek(TIM1_SR), 0);
    chip.write(TIM1_BDTR, 0x9E00);
    assert_eq!(chip.outputs(), on);
}

#[test]
fn without_the_break_input_nothing_trips() {
    // Off, or another timer's.
    for (address, value) in [(TIM1_BDTR, 0x8E00), (GPIOA_AFRL, 3 << 24)] {
        let mut chip = armed();
        chip.write(address, value);
        chip.open_stop();
        assert!(chip.outputs().enable);
    }
}

#[test]
fn what_is_not_0_is_watched_and_what_was_read_as_0_then_is_told() {
    let mut chip = Chip::new(Board::OLIMEX_H405);
    chip.starts = false;
    chip.lines.ready = false;
    let has = |chip: &Chip, at| chip.watched().contains(&(at, 4));
    assert!(has(&chip, GPIOA_IDR) && !has(&chip, GPIOB_IDR));
    assert!(!chip.misread(GPIOB_IDR));
    chip.lines.ready = true;
    assert!(has(&chip, GPIOB_IDR) && chip.misread(GPIOB_IDR));
    chip.open_stop();
    assert!(!has(&chip, GPIOA_IDR));
}

#[test]
fn a_cycle_counter_that_does_not_stand_is_watched_and_moves_at_every_reading() {
    let mut chip = Chip::new(Board::NUCLEO_F446ZE);
    let watched = |chip: &Chip| chip.watched().contains(&(DWT_CYCCNT, 4));
    let mut read = |counter| {
        chip.lines.cycle_counter = counter;
        (watched(&chip), [0; 3].map(|_| chip.read(DWT_CYCCNT)))
    };
    assert_eq!(read(CycleCounter::Stands), (false, [0; 3]));
    let back = 1_u32.wrapping_neg();
    assert_eq!(
        read(CycleCounter::Moves(back)),
        (true, [back, back - 1, back - 2])
    );
    let (is_watched, [a, b, c]) = read(CycleCounter::Jumps);
    assert!(is_watched && a != b && b != c && a != c);
}

#[test]
fn a_dead_crystal_is_waited_for_and_counted() {
    let mut chip = Chip::new(Board::OLIMEX_H405);
    chip.write(RCC_CR, 0x83 | HSE_ON);
    assert_ne!(chip.read(RCC_CR) & 1 << 17, 0);
    assert_eq!(chip.waits, 0);
    assert!(!chip.lose_crystal(), "nobody asked to be told");
    assert_eq!(chip.read(RCC_CR) & 1 << 17, 0);
    assert_eq!(chip.waits, 1);
}

#[test]
fn every_change_of_the_outputs_is_kept_in_order() {
    let mut chip = armed();
    let orders: Vec<_> = chip.changes.iter().map(|o| (o.pulses, o.enable)).collect();
    assert_eq!(orders[orders.len() - 2..], [(true, false), (true, true)]);
    chip.changes.clear();
    chip.write(TIM1_CCMR1, 0x40);
    chip.write(TIM1_CCMR1, 0x40);
    assert_eq!(chip.changes.len(), 1);
}
