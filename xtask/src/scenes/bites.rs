//! An anastomosis whose thread rubs. Around 50 punctures tension falls by a factor of some thousand, so that a pull at its
//! ends closes the last bites only: hands draw the thread together bite by bite, as a surgeon does.
//!
//! Entry point: [`tightened`]. It differs from [`super::tubes::anastomosis`] in its thread, in that the tail is held still, and in how far the head is drawn out.

use super::stitch::Sewing;
use super::tubes;

const PUNCTURES: u32 = 50;
const FRICTION: f64 = 0.1;
/// What is left of the bridges' length, and how long shortening them takes \[s\].
const RATIO: f64 = 0.1;
const TAKES_S: f64 = 2.4;
/// What hands draw with \[N\], and by how much the console draws the head out meanwhile \[m\].
const MOST_N: f64 = 0.5;
const HEAD_M: f64 = 0.03;

/// The scene.
pub fn tightened() -> String {
    let text = tubes::drawn(PUNCTURES, HEAD_M);
    let text = instead(
        &text,
        ["name = ", "\n"],
        "name = \"Two tubes, drawn together\"",
    );
    let told = format!(
        "# Two tubes end to end are sewn together with one thread: {PUNCTURES} punctures, then what bridges the gap is\n# shortened, bite by bite."
    );
    let text = instead(&text, ["# Two tubes end to end", "\n#\n"], &told);
    let from_s = sewn_s(&tubes::sewing(PUNCTURES)) + 0.1;
    let until_s = from_s + TAKES_S;
    // The tail's hand stays where it takes it.
    let text = instead(
        &text,
        ["# Carries the needle to the next bite", "\n"],
        "# Carries the needle to the next bite, held likewise, and holds the tail.",
    );
    let leaves = format!("  {{ time_s = {:.3}, position_m", from_s + tubes::PULL_S);
    let text = instead(&text, [&leaves, "]\n\n# The hand is a spring"], "");
    let thread = format!(
        "# It rubs: a pull at its ends would close the last bites only.
[[thread]]
needle = 0
length_m = 0.6
friction = {FRICTION:?}
hold = [
  {{ time_s = {:.3}, end = \"tail\", tool = 2 }},
]
tighten = [
  {{ time_s = {from_s:.3}, until_s = {until_s:.3}, ratio = {RATIO:?}, in_turn = true, most_n = {MOST_N:?} }},
]

",
        from_s - 0.05
    );
    instead(&text, ["# Frictionless", "# What closes."], &thread)
}

fn sewn_s(sewing: &Sewing) -> f64 {
    let ends_s = sewing.script().ends_s;
    ends_s.last().copied().unwrap_or(0.0)
}

/// `text` with `new` in place of what begins with `from` and ends before the next `to`; empty if that is not there.
fn instead(text: &str, [from, to]: [&str; 2], new: &str) -> String {
    let found = text.find(from).and_then(|start| {
        let end = text[start..].find(to)?;
        Some([&text[..start], new, &text[start + end..]].concat())
    });
    found.unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Where the plain scene says something else, this one says its own.
    #[test]
    fn it_has_a_thread_of_its_own() {
        let text = tightened();
        for (what, count) in [
            ("drawn together", 1),
            ("# shortened, bite by bite.", 1),
            ("friction = 0.1", 1),
            ("tighten = [", 1),
            ("[[thread]]", 1),
            ("[[tissue_contact]]", 1),
            ("end = ", 1),
            ("and holds the tail", 1),
            ("time_s = 19.360", 1),
            ("[hand]", 1),
        ] {
            assert_eq!(text.matches(what).count(), count, "{what}");
        }
    }
}
