//! As much as a line can bring, of one kind at a time: 1 MB/s, of which the image takes what a tick may. `SUTURA_FULL=1`: 10 s of each.

use super::{Bench, On, is_full};
use sutura_shared::wire::List;
use sutura_shared::wire::message::{Command, Mode, Ping, Row, RowKind, Rows};

/// Packets that wait before every tick: 1 MB/s.
const OFFERED: usize = 16;
/// Packets that a tick takes at most: its budget of 768 bytes, and what its FIFO has room for.
const MOST_PACKETS: usize = 12 + 2;
/// Cycles of a tick. All that a tick brings about takes fewer instructions on average, or bytes would be taken that nobody has time for; a
/// frame of rows is unpacked in one piece, which the control task interrupts and telemetry waits for: twice as many for one tick.
const CYCLES: u32 = 168_000;

fn ticks() -> usize {
    if is_full() { 10_000 } else { 500 }
}

/// Ticks whose instructions are counted, which is slow: five frames of rows, and all others many times.
const COUNTED: usize = 16;

/// Ticks beside which the line never ends: many, and some of which every instruction is counted.
fn flood(on: On, name: &str, say: impl FnMut(&mut Bench) + Clone) {
    let taken = last(Bench::start(on), ticks(), say.clone(), |_| {});
    let rate = taken * 64 / ticks();
    let mut board = on.power_up_counting();
    board.boot().unwrap();
    let mut bench = Bench::of(on, board);
    bench.open();
    let mut costs = Vec::new();
    last(bench, COUNTED, say, |bench| {
        costs.push(bench.board.instructions().unwrap());
    });
    // What came before the first.
    costs.remove(0);
    let most = costs.iter().max().copied().unwrap();
    let mean = costs.iter().sum::<u32>() / costs.len() as u32;
    eprintln!("{name}: {rate} kB/s, {mean} instructions a tick, {most} at most");
    assert!(mean > 1000 && mean < CYCLES, "{costs:?}");
    assert!(most < 2 * CYCLES, "{costs:?}");
    assert!(rate > 200, "{rate}");
}

/// So many ticks; how many packets they took.
fn last(
    mut bench: Bench,
    ticks: usize,
    mut say: impl FnMut(&mut Bench),
    mut count: impl FnMut(&mut Bench),
) -> usize {
    bench.arm();
    bench.compares = false;
    let mut taken = 0;
    for tick in 0..ticks {
        let waiting = loop {
            let waiting = bench.board.waiting() + bench.down.len().div_ceil(64);
            if waiting >= OFFERED {
                break waiting;
            }
            say(&mut bench);
        };
        let fed = bench.board.chip().feeds;
        let (_, before) = bench.state.unwrap();
        bench.try_tick().unwrap_or_else(|error| panic!("{error}"));
        count(&mut bench);
        let packets = waiting - bench.board.waiting();
        // The first ones have what those before left of their budget, too.
        assert!(
            tick < 4 || packets <= MOST_PACKETS,
            "{packets} packets in tick {tick}"
        );
        taken += packets;
        // Every task has run.
        let feeds = bench.board.chip().feeds;
        assert!(feeds.window > fed.window && feeds.independent > fed.independent);
        let (_, state) = bench.state.unwrap();
        assert_eq!((state.tick, state.faults), (before.tick + 1, 0));
        assert_eq!(state.mode, Mode::Armed);
    }
    bench.say_speed("flooded");
    let report = bench.report.unwrap();
    assert_eq!((report.tick_overruns, report.ticks_late), (0, 0));
    taken
}

on_each_board!(contacts);
fn contacts(on: On) {
    flood(on, "contacts", |bench| {
        let contact = bench.floor();
        bench.say(&contact);
    });
}

on_each_board!(rows);
fn rows(on: On) {
    flood(on, "24 rows and their contacts", |bench| {
        let height = bench.state.unwrap().1.position_m[2];
        let row = |at: usize| Row {
            kind: RowKind::Smooth { id: at as u32 },
            delta_free_m: height - 1e-3 + 1e-5 * at as f32,
            lambda_n: 0.0,
            jacobian: [0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
        };
        let entry = |row: usize, column: usize| 0.03 / (1 + column - row) as f32;
        let upper = (0..24).flat_map(|row| (row..24).map(move |column| entry(row, column)));
        bench.say(&Rows {
            tool: 0,
            held: [0.0; 21],
            curvature_per_m: 0.0,
            rows: List::of((0..24).map(row)),
            compliance: List::of(upper),
        });
        let contact = bench.floor();
        bench.say(&contact);
    });
}

on_each_board!(orders);
fn orders(on: On) {
    flood(on, "orders", |bench| {
        bench.say(&Command::StateEvery { ticks: 1 });
    });
}

on_each_board!(noise);
fn noise(on: On) {
    flood(on, "noise", noisy());
}

/// Of the same traffic so much that a tick without a budget would take more.
pub(super) fn a_tick_takes_no_more_than_its_budget(on: On) {
    last(Bench::start(on), 10, noisy(), |_| {});
}

/// With a frame of the host now and then, or the session would end.
fn noisy() -> impl FnMut(&mut Bench) + Clone {
    let mut random = fastrand::Rng::with_seed(5);
    let mut count = 0;
    move |bench| {
        bench.down.extend((0..1000).map(|_| random.u8(..)));
        count += 1;
        if count % 20 == 0 {
            bench.down.push(0);
            bench.say(&Ping { host_us: count });
        }
    }
}
