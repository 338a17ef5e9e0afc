//! `cargo xtask scenes`: writes the scenes whose scripts nobody would write by hand.
//! Entry point: [`gated`].

mod bites;
mod drawn;
mod hand_over_hand;
mod knots;
mod slabs;
mod stitch;
mod tubes;
mod turn;
mod write;

use crate::run::root;
use anyhow::{Context, Result, bail};

/// Files below `scenes/` and what they say.
fn files() -> [(&'static str, String); 6] {
    [
        ("anastomosis-20.toml", tubes::anastomosis(20)),
        ("anastomosis-20-by-hand.toml", hand_over_hand::by_hand()),
        ("anastomosis-50.toml", tubes::anastomosis(50)),
        ("anastomosis-50-tighten.toml", bites::tightened()),
        ("wound-slabs.toml", slabs::wound()),
        ("wound-slabs-knots.toml", knots::interrupted()),
    ]
}

/// Writes the scenes; with `check` it only says whether they are as they would be written.
pub fn gated(check: bool) -> Result<()> {
    let mut stale = Vec::new();
    for (name, text) in files() {
        let path = root().join("scenes").join(name);
        let is_there = std::fs::read_to_string(&path).is_ok_and(|old| old == text);
        if is_there {
            continue;
        }
        if check {
            stale.push(name);
        } else {
            std::fs::write(&path, text).with_context(|| format!("writing {}", path.display()))?;
            println!("scenes/{name}");
        }
    }
    if !stale.is_empty() {
        bail!(
            "not what the generator writes: {}; run `cargo xtask scenes`",
            stale.join(", ")
        );
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_committed_scenes_are_the_generated_ones() {
        gated(true).expect("`cargo xtask scenes` has been run");
    }
}
