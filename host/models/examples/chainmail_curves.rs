//! Curves of the ellipsoid-bounded ChainMail, as CSV: force by depth, a loading loop, relaxation, and what mass and step
//! do to the force.
//!
//! `cargo run --release -p sutura-models --example chainmail_curves -- [depth|printed|loop|relaxation|bar|mass]`

use sutura_mesh::{TetMesh, slab};
use sutura_models::chainmail::{
    ClassicalChainMail, ClassicalSettings, EllipsoidChainMail, EllipsoidSettings,
};
use sutura_models::shape_matching::{ShapeMatching, ShapeMatchingSettings};
use sutura_models::{BoundaryConditions, Material, Tissue};

type Failure = Box<dyn std::error::Error>;

const LIVER: Material = Material {
    youngs_modulus_pa: 3_500.0,
    poisson_ratio: 0.47,
};

/// Half a square that holds one node only: zhang-2017 moves "the contact point".
const POINT_M: f64 = 1e-6;
/// Half a square of 8 mm.
const SQUARE_M: f64 = 0.0041;

/// A body with its bottom held and a square of its top moved.
struct Poke {
    mesh: TetMesh,
    held: Vec<(u32, [f64; 3])>,
    moved: Vec<usize>,
}

impl Poke {
    fn new(mesh: TetMesh, half_m: f64) -> Self {
        let low = mesh.points_m()[0][2];
        let (mut held, mut moved) = (Vec::new(), Vec::new());
        for (node, p) in mesh.points_m().iter().enumerate() {
            let top = p[2] > -1e-9 && p[0].abs() <= half_m && p[1].abs() <= half_m;
            if top {
                moved.push(held.len());
            }
            if top || p[2] < low + 1e-9 {
                held.push((node as u32, [0.0; 3]));
            }
        }
        Self { mesh, held, moved }
    }

    /// One step with the square `depth_m` deep: the force that takes \[N\], and m dv/dt of what moves, (3.48).
    fn press(&mut self, tissue: &mut dyn Tissue, depth_m: f64, step_s: f64) -> (f64, f64) {
        for index in &self.moved {
            self.held[*index].1 = [0.0, 0.0, -depth_m];
        }
        let drive = BoundaryConditions {
            held: &self.held,
            force_n: &[],
        };
        let report = tissue.step(&drive, step_s);
        let forces = tissue.reactions_n();
        let force = -self.moved.iter().map(|at| forces[*at][2]).sum::<f64>();
        (force, report.momentum[2])
    }
}

/// 20 mm and 1,331 elements: the cube of fig. 3.20, with the size of 3.3.5.4.
fn cube() -> Result<TetMesh, Failure> {
    Ok(slab([0.02; 3], [10; 3])?)
}

fn tissue(mesh: &TetMesh, limit: f64, stiffness: f64) -> Result<EllipsoidChainMail, Failure> {
    let settings = EllipsoidSettings {
        strain_limit: [limit; 3],
        stiffness,
        visits: 50,
        ..EllipsoidSettings::default()
    };
    Ok(EllipsoidChainMail::new(mesh, LIVER, settings)?)
}

/// Force by depth at a constant 5 mm/s for the limits of fig. 3.17, each the mean since the row before.
fn limits(stiffness: f64, rows: u32, ticks: u32) -> Result<(), Failure> {
    println!("depth_mm,force_n_limit_0.1,force_n_limit_0.3,force_n_limit_0.5");
    let mut poke = Poke::new(cube()?, POINT_M);
    let mut all = [0.1, 0.3, 0.5]
        .map(|limit| tissue(&poke.mesh, limit, stiffness))
        .into_iter()
        .collect::<Result<Vec<_>, _>>()?;
    for row in 0..rows {
        let mut mean = vec![0.0; all.len()];
        let mut depth_m = 0.0;
        for tick in 1..=ticks {
            depth_m = 5e-6 * f64::from(row * ticks + tick);
            for (mean, tissue) in mean.iter_mut().zip(&mut all) {
                *mean += poke.press(tissue, depth_m, 1e-3).0 / f64::from(ticks);
            }
        }
        let [a, b, c] = [mean[0], mean[1], mean[2]];
        println!("{:.2},{a:.6},{b:.6},{c:.6}", 1e3 * depth_m);
    }
    Ok(())
}

/// Fig. 3.17 with springs.
fn depth() -> Result<(), Failure> {
    limits(1.0, 12, 50)
}

/// Fig. 3.17 as printed, without springs.
fn printed() -> Result<(), Failure> {
    limits(0.0, 10, 200)
}

/// Force by depth going to 2 mm and back, within 0.2, 0.8 and 3.2 s in all (as fig. 3.18), each the mean over the
/// fifth of a millimetre around its depth.
fn hysteresis() -> Result<(), Failure> {
    println!("depth_mm,in_0.1s,out_0.1s,in_0.4s,out_0.4s,in_1.6s,out_1.6s");
    let mut poke = Poke::new(cube()?, POINT_M);
    let mut table = vec![[0.0; 6]; 11];
    for (rate, ticks) in [100, 400, 1600].into_iter().enumerate() {
        let mut tissue = tissue(&poke.mesh, 0.3, 1.0)?;
        let mut counts = vec![[0.0; 6]; 11];
        for tick in 1..=2 * ticks {
            let share = f64::from(ticks - i32::abs(ticks - tick)) / f64::from(ticks);
            let (force, _) = poke.press(&mut tissue, 2e-3 * share, 1e-3);
            let column = 2 * rate + usize::from(tick > ticks);
            let row = (10.0 * share).round() as usize;
            counts[row][column] += 1.0;
            table[row][column] += (force - table[row][column]) / counts[row][column];
        }
    }
    for (row, forces) in table.iter().enumerate() {
        let forces = forces.map(|force| format!("{force:.6}")).join(",");
        println!("{:.1},{forces}", 0.2 * row as f64);
    }
    Ok(())
}

/// Force by time at 2 mm, reached within 50 ms (as fig. 3.19), with springs and as printed.
fn relaxation() -> Result<(), Failure> {
    println!("time_s,force_n,force_n_as_printed");
    let mut poke = Poke::new(cube()?, POINT_M);
    let mut both = [tissue(&poke.mesh, 0.3, 1.0)?, tissue(&poke.mesh, 0.3, 0.0)?];
    for tick in 1..=300 {
        let depth_m = 4e-5 * f64::from(tick.min(50));
        let [springs, bare] = both
            .each_mut()
            .map(|tissue| poke.press(tissue, depth_m, 1e-3).0);
        if tick % 25 == 0 || (50..60).contains(&tick) {
            println!("{:.3},{springs:.6},{bare:.6}", 1e-3 * f64::from(tick));
        }
    }
    Ok(())
}

/// Force of a bar of 10 x 10 x 40 mm stretched by 1 %, against E A e.
fn bar() -> Result<(), Failure> {
    println!("cells_across,ellipsoid_n,classical_n,shape_matching_n,e_a_strain_n");
    for across in [2, 4, 6] {
        let mesh = slab([0.01, 0.01, 0.04], [across, across, 4 * across])?;
        let mut poke = Poke::new(mesh, 1.0);
        let boxes = ClassicalSettings {
            relaxations: 20,
            ..ClassicalSettings::default()
        };
        let mut all: [Box<dyn Tissue>; 3] = [
            Box::new(tissue(&poke.mesh, 0.3, 1.0)?),
            Box::new(ClassicalChainMail::new(&poke.mesh, LIVER, boxes)?),
            Box::new(ShapeMatching::new(
                &poke.mesh,
                LIVER,
                ShapeMatchingSettings::default(),
            )?),
        ];
        let mut row = format!("{across}");
        for tissue in &mut all {
            let mut force = 0.0;
            for _ in 0..3000 {
                force = poke.press(&mut **tissue, -4e-4, 1e-3).0;
            }
            row += &format!(",{:.6}", -force);
        }
        println!("{row},{:.6}", 3_500.0 * 1e-4 * 0.01);
    }
    Ok(())
}

/// What mass and step do: the force at 20 mm/s on the way at 2 mm, m dv/dt beside it, and the force at rest.
fn mass() -> Result<(), Failure> {
    println!(
        "density_kg_per_m3,step_ms,mass_factor,force_moving_n,m_dv_dt_n,m_v_dt_n,force_at_rest_n"
    );
    for density_kg_per_m3 in [106.0, 1060.0, 10_600.0] {
        for step_s in [1e-4, 5e-4, 1e-3, 2e-3, 5e-3] {
            let mut poke = Poke::new(cube()?, SQUARE_M);
            let settings = EllipsoidSettings {
                density_kg_per_m3,
                visits: 50,
                ..EllipsoidSettings::default()
            };
            let mut tissue = EllipsoidChainMail::new(&poke.mesh, LIVER, settings)?;
            let (mut force, mut last, mut push, mut depth_m) = (0.0, 0.0, (0.0, 0.0), 0.0);
            while depth_m < 2e-3 - 1e-9 {
                depth_m += 20e-3 * step_s;
                let (now, momentum) = poke.press(&mut tissue, depth_m, step_s);
                // As (3.48) with the change of velocity, and as printed.
                push = ((last - momentum) / step_s, -momentum / step_s);
                (force, last) = (now, momentum);
            }
            let mut at_rest = 0.0;
            for _ in 0..(3.0 / step_s).min(6000.0) as u32 {
                at_rest = poke.press(&mut tissue, depth_m, step_s).0;
            }
            println!(
                "{density_kg_per_m3},{},{:.2},{force:.5},{:.5},{:.5},{at_rest:.5}",
                1e3 * step_s,
                tissue.mass_factor(),
                push.0,
                push.1
            );
        }
    }
    Ok(())
}

fn main() -> Result<(), Failure> {
    let which = std::env::args().nth(1);
    let all = [
        ("depth", depth as fn() -> Result<(), Failure>),
        ("printed", printed),
        ("loop", hysteresis),
        ("relaxation", relaxation),
        ("bar", bar),
        ("mass", mass),
    ];
    for (name, print) in all {
        if which.as_deref().is_none_or(|which| which == name) {
            println!("# {name}");
            print()?;
        }
    }
    Ok(())
}
