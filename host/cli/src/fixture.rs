//! A fixture from the command line: `wall:z=0.0,k=800` or `coupling:x=0,y=0,z=0.01,k=400,b=1`.
//!
//! Entry point: [`parse`].

use sutura_shared::wire::Message;
use sutura_shared::wire::message::Fixture;

/// A level wall at a height, or a coupling at a point; stiffness `k` \[N/m\] and damping `b` \[N s/m\], 0 when left out.
///
/// # Errors
/// What is wrong with the text, and what is expected.
pub fn parse(text: &str) -> Result<Fixture, String> {
    let expected =
        "expected wall:z=M,k=N_PER_M[,b=N_S_PER_M] or coupling:x=M,y=M,z=M,k=N_PER_M[,b=..]";
    let (what, list) = text.split_once(':').ok_or(expected)?;
    let keys: &[&str] = match what {
        "wall" => &["z", "k", "b"],
        "coupling" => &["x", "y", "z", "k", "b"],
        _ => return Err(expected.to_owned()),
    };
    let mut values = [None; 5];
    for part in list.split(',') {
        let (key, value) = part.split_once('=').ok_or(expected)?;
        let index = keys.iter().position(|known| *known == key.trim());
        let slot = index.and_then(|index| values.get_mut(index));
        let slot = slot.ok_or_else(|| format!("unknown key `{key}`: {expected}"))?;
        let number = value.trim().parse::<f32>();
        *slot = Some(number.map_err(|_| format!("`{value}` is no number"))?);
    }
    let value = |key: &str| {
        let index = keys.iter().position(|known| *known == key);
        let found = index.and_then(|index| values.get(index).copied().flatten());
        found.ok_or_else(|| format!("`{key}` is missing: {expected}"))
    };
    let damping_n_s_per_m = value("b").unwrap_or(0.0);
    let fixture = match what {
        "wall" => Fixture::Wall {
            point_m: [0.0, 0.0, value("z")?],
            normal: [0.0, 0.0, 1.0],
            stiffness_n_per_m: value("k")?,
            damping_n_s_per_m,
        },
        _ => Fixture::Coupling {
            anchor_m: [value("x")?, value("y")?, value("z")?],
            stiffness_n_per_m: value("k")?,
            damping_n_s_per_m,
        },
    };
    match fixture.check() {
        Ok(()) => Ok(fixture),
        Err(reject) => Err(format!(
            "no console takes it ({reject}): places within 10 m, k and b not negative"
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn walls_and_couplings_are_read() {
        let wall = Fixture::Wall {
            point_m: [0.0, 0.0, -0.01],
            normal: [0.0, 0.0, 1.0],
            stiffness_n_per_m: 800.0,
            damping_n_s_per_m: 0.0,
        };
        assert_eq!(parse("wall:z=-0.01,k=800"), Ok(wall));
        let coupling = Fixture::Coupling {
            anchor_m: [0.1, 0.0, 0.02],
            stiffness_n_per_m: 400.0,
            damping_n_s_per_m: 1.5,
        };
        assert_eq!(parse("coupling:x=0.1,y=0,z=0.02,k=400,b=1.5"), Ok(coupling));
    }

    #[test]
    fn what_is_wrong_is_named() {
        let wrong = |text, part: &str| {
            let message = parse(text).expect_err("not a fixture");
            assert!(message.contains(part), "{text}: {message}");
        };
        wrong("wall", "expected wall:");
        wrong("floor:z=0,k=1", "expected wall:");
        wrong("wall:z=0", "`k` is missing");
        wrong("wall:z=0,k=soft", "`soft` is no number");
        wrong("wall:x=0,k=1", "unknown key `x`");
        wrong("wall:z=0,k=-1", "no console takes it");
        wrong("wall:z=11,k=1", "no console takes it");
    }
}
