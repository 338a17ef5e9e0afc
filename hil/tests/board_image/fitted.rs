//! The image of a board with everything on it that there is a driver for: `firmware/src/board/fitted.rs`.

use super::guards::{fault, recover};
use super::{Bench, On, sessions};
use sutura_hil::board_image::Fitted;
use sutura_shared::wire::faults;
use sutura_shared::wire::message::{Command, Mode};

fn on_it(bench: &mut Bench) -> &mut Fitted {
    bench.board.chip().fitted.as_mut().unwrap()
}

/// Joint 3 by its angle sensor, the others by encoders that count: a session as any other, to the bit.
#[test]
fn an_angle_over_spi_is_felt_as_counts_are() {
    sessions::contacts_are_felt_as_the_shared_code_renders_them(On::FITTED);
}

/// Low, too high, and an open line; while nobody wants motors it may be off.
pub(super) fn a_motors_supply_that_is_unfit_under_power_is_a_fault(on: On) {
    let mut bench = Bench::start(on);
    bench.push();
    for volts in [19.0, 29.0, 0.0] {
        on_it(&mut bench).supply_v = volts;
        // One reading is noise.
        assert_eq!(bench.tick().faults, 0);
        fault(&mut bench, faults::SUPPLY | faults::BOARD);
        on_it(&mut bench).supply_v = 24.0;
        bench.tick();
        recover(&mut bench);
    }
    // It goes with the tick that disarms, while the last pulses run: nobody wants it any more.
    bench.say(&Command::Disarm);
    assert_eq!(bench.tick().mode, Mode::Idle);
    assert!(bench.outputs().pulses && !bench.outputs().enable);
    on_it(&mut bench).supply_v = 0.0;
    for _ in 0..60 {
        let state = bench.tick();
        assert_eq!((state.mode, state.faults), (Mode::Idle, 0));
    }
    assert!(!bench.outputs().pulses);
    bench.say(&Command::Arm);
    bench.tick();
    fault(&mut bench, faults::SUPPLY | faults::BOARD);
    bench.say_speed("the motors' supply");
}

/// The angle sensor's line, its bus, both end stops at once, a thermistor that is hot or gone.
pub(super) fn sensors_that_are_broken_or_hot_are_a_fault(on: On) {
    let mut bench = Bench::start(on);
    bench.push();
    let well = *on_it(&mut bench);
    type Breaks = fn(&mut Fitted);
    let ways: [(u32, Breaks); 6] = [
        (2, |on_it| on_it.stuck = Some(u16::MAX)),
        (2, |on_it| on_it.stuck = Some(0)),
        // Waited for as long as a byte may take, in every tick.
        (2, |on_it| on_it.bus_dead = true),
        (0, |on_it| on_it.stops_closed = [false; 2]),
        // 90 degrees Celsius.
        (2, |on_it| on_it.thermistor = 0.085),
        (2, |on_it| on_it.thermistor = 1.0),
    ];
    for (bridged, breaks) in ways {
        breaks(on_it(&mut bench));
        for _ in 0..bridged {
            assert_eq!(bench.tick().faults, 0);
        }
        fault(&mut bench, faults::BOARD);
        *on_it(&mut bench) = well;
        bench.tick();
        recover(&mut bench);
    }
    // One end stop is where a joint may be.
    on_it(&mut bench).stops_closed = [false, true];
    assert_eq!(bench.tick().faults, 0);
    bench.say_speed("sensors");
}
