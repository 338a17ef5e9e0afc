//! The self-test's images on a board without jumpers. With them, from the file to the report: `tests/flash/selftest.rs`.

use super::{On, known, time_limit};
use sutura_hil::board_image::{BoardImage, default_selftest};

/// Ticks after which what jumpers are for has been checked.
const MOST_TICKS: usize = 1000;

on_each_board!(without_jumpers_each_check_of_theirs_fails);
fn without_jumpers_each_check_of_theirs_fails(on: On) {
    let image = known(&default_selftest(on.board));
    let board = BoardImage::power_up(on.board, image, time_limit());
    let mut board = board.unwrap_or_else(|e| panic!("{e}"));
    board.boot().unwrap_or_else(|e| panic!("{e}"));
    board.enumerate().unwrap_or_else(|e| panic!("{e}"));
    for _ in 0..20 {
        board.tick().unwrap();
    }
    assert!(board.take().is_empty(), "nobody has asked");
    board.send(b"t");
    let mut said = String::new();
    for _ in 0..MOST_TICKS {
        let ticked = board.tick();
        ticked.unwrap_or_else(|e| panic!("{e}, after {said}"));
        said.push_str(std::str::from_utf8(&board.take()).unwrap());
        if said.contains("encoder_3_backward") && said.ends_with('\n') {
            break;
        }
    }
    let failed = said.lines().filter_map(|line| line.strip_prefix("FAIL "));
    let failed: Vec<_> = failed.filter_map(|rest| rest.split(' ').next()).collect();
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
    ];
    assert_eq!(failed, expected, "{said}");
    assert!(!board.chip().outputs().enable, "left on");
    eprintln!("{said}{}", board.speed());
}
