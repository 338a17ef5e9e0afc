//! A soft sphere on a console, without any solver: `cargo run -p sutura-client --example sphere -- PORT`.
//!
//! `sutura console --link /tmp/console` makes a virtual console to try it on; a scripted hand then presses into the
//! sphere from above. On a console with motors the hand is yours, and the sphere is under the middle of its travel.

use std::time::{Duration, Instant};
use sutura_client::message::{HandScript, Simulate, WAY_POINTS, WayPoint};
use sutura_client::{Console, Contact, Error, Options};

/// Its top is the origin.
const MIDDLE_M: [f32; 3] = [0.0, 0.0, -0.05];
const RADIUS_M: f32 = 0.05;
const STIFFNESS_N_PER_M: f32 = 400.0;

/// Force along the outward normal n: k (R - d), d from the middle. From there it changes by -k n n' along the normal,
/// and across it by F/d (I - n n'), because the normal turns.
fn sphere(grip_m: [f32; 3]) -> Contact {
    let away: [f32; 3] = std::array::from_fn(|i| grip_m[i] - MIDDLE_M[i]);
    let distance = away.iter().map(|x| x * x).sum::<f32>().sqrt().max(1e-6);
    let normal = away.map(|x| x / distance);
    let push = STIFFNESS_N_PER_M * (RADIUS_M - distance).max(0.0);
    let tangent = std::array::from_fn(|i| {
        std::array::from_fn(|j| {
            let along = normal[i] * normal[j];
            let across = if i == j { 1.0 - along } else { -along };
            push / distance * across - STIFFNESS_N_PER_M * along
        })
    });
    if push > 0.0 {
        Contact::touching(normal.map(|n| push * n), normal).with_stiffness(tangent)
    } else {
        Contact::apart(distance - RADIUS_M, normal).with_stiffness(tangent)
    }
}

/// From 10 mm above the sphere to 10 mm below its top, and a little aside.
fn hand() -> Simulate {
    let mut way_points = [WayPoint::default(); WAY_POINTS];
    way_points[0].position_m = [0.0, 0.0, 0.01];
    way_points[1] = WayPoint {
        time_s: 0.5,
        position_m: [0.004, 0.0, -0.01],
    };
    Simulate::Hand(HandScript {
        stiffness_n_per_m: 1000.0,
        damping_n_s_per_m: 10.0,
        start_joint: [0.0, 0.0, 0.01],
        count: 2,
        way_points,
    })
}

fn main() -> Result<(), Error> {
    let mut arguments = std::env::args().skip(1);
    let Some(port) = arguments.next() else {
        eprintln!("usage: sphere PORT [SECONDS]");
        std::process::exit(2);
    };
    let seconds = arguments.next().and_then(|word| word.parse().ok());
    let end = Instant::now() + Duration::from_secs_f64(seconds.unwrap_or(3.0));

    let console = Console::open(&port, Options::default())?;
    if console.info().simulated {
        console.simulate(&hand())?;
    }
    console.arm()?;
    let mut tick = 0;
    while Instant::now() < end {
        let Some(pose) = console.pose(Duration::from_millis(500))? else {
            eprintln!("nothing came from the console for half a second");
            continue;
        };
        console.send_contact(&pose, &sphere(pose.position_m))?;
        if pose.tick >= tick {
            tick = pose.tick + 100;
            let [x, y, z] = pose.position_m.map(|x| 1e3 * x);
            println!(
                "{:?}  {x:6.2} {y:6.2} {z:6.2} mm  {:.2?} N",
                pose.mode, pose.force_n
            );
        }
        // A simulator takes its time.
        std::thread::sleep(Duration::from_millis(8));
    }
    println!("{:?}", console.close());
    Ok(())
}
