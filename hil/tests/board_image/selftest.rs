//! The self-test's images, with jumpers and without.

use super::{On, TIME_LIMIT, known};
use sutura_hil::board_image::{BoardImage, default_selftest};

/// Lines of a run.
fn report(on: On, jumpers: bool) -> Vec<String> {
    let image = known(&default_selftest(on.board));
    let mut board =
        BoardImage::power_up(on.board, image, TIME_LIMIT).unwrap_or_else(|e| panic!("{e}"));
    board.chip().lines.jumpers = jumpers;
    board.boot().unwrap_or_else(|e| panic!("{e}"));
    board.enumerate().unwrap_or_else(|e| panic!("{e}"));
    for _ in 0..20 {
        board.tick().unwrap();
    }
    assert!(board.take().is_empty(), "nobody has asked");
    board.send(b"t");
    let mut text = String::new();
    for _ in 0..700 {
        board.tick().unwrap_or_else(|e| panic!("{e}"));
        text.push_str(std::str::from_utf8(&board.take()).unwrap());
        if text.contains("end ") && text.ends_with('\n') {
            break;
        }
    }
    assert!(!board.chip().outputs().enable, "left on");
    eprintln!("{text}{}", board.speed());
    text.lines().map(str::to_owned).collect()
}

fn failed(lines: &[String]) -> Vec<&str> {
    let names = lines.iter().filter_map(|line| line.strip_prefix("FAIL "));
    names.filter_map(|rest| rest.split(' ').next()).collect()
}

on_each_board!(with_its_jumpers_a_board_fails_only_what_the_emulator_lacks);
pub(super) fn with_its_jumpers_a_board_fails_only_what_the_emulator_lacks(on: On) {
    let lines = report(on, true);
    // No cycle counter.
    assert_eq!(failed(&lines), ["clocks", "tick_cost"]);
    assert_eq!(lines.len(), 15, "{lines:?}");
    assert!(lines.contains(&"pass encoder_3_backward -400 of -400 counts".to_owned()));
    assert_eq!(lines[14], "end 12 passed 2 failed");
}

on_each_board!(without_jumpers_each_check_of_theirs_fails);
pub(super) fn without_jumpers_each_check_of_theirs_fails(on: On) {
    let lines = report(on, false);
    let expected = [
        "clocks",
        "stop_line",
        "ready_line",
        "stop_cuts",
        "encoder_1_forward",
        "encoder_2_forward",
        "encoder_3_forward",
        "encoder_1_backward",
        "encoder_2_backward",
        "encoder_3_backward",
        "tick_cost",
    ];
    assert_eq!(failed(&lines), expected);
}
