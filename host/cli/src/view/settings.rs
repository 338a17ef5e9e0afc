//! What a page can set of a session: numbers of its plan, and those that its scene's file says of the tissue.
//!
//! Entry points: [`Setting::all`], [`Setting::flaw`], [`edited`]. What is of the plan changes at once. What the file says is
//! written anew in its text, so that it is checked as the file is, and that a recording has it: that makes another session.

use super::prepare::Wish;
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::ops::Range;
use sutura_host::scene::{Document, Rendering, Scene};
use sutura_host::session::{Plan, Tuning};
use sutura_shared::wire::message::Fixture;
use sutura_view::SetTo;
use toml::Spanned;

const RENDERING: &str = "rendering";
const HOST_HZ: &str = "host-hz";
const STIFFNESS: &str = "hand-stiffness";
const DAMPING: &str = "hand-damping";
const FIXTURE: &str = "fixture";
const RENDERINGS: [Rendering; 3] = [Rendering::Hold, Rendering::Tangent, Rendering::Rows];
const AT_ONCE: [&str; 5] = [RENDERING, HOST_HZ, STIFFNESS, DAMPING, FIXTURE];
/// A file's number is changed by this factor at most.
const FARTHEST: f64 = 10.0;
/// Largest Poisson's ratio to choose: beyond it meshes lock.
const LARGEST_RATIO: f64 = 0.49;
/// Friction to choose where the file says that there is none \[N/m\].
const SOME_FRICTION_N_PER_M: f64 = 100.0;

/// The wall is so far below where the grip is \[m\]: to be come upon, not to be begun in.
const WALL_BELOW_M: f32 = 0.005;
/// Of wall and coupling: a device that cannot render it stably caps it \[N/m\], \[N s/m\].
const FIXTURE_N_PER_M: f32 = 800.0;
const FIXTURE_N_S_PER_M: f32 = 1.0;

/// What the console renders by itself, beside the tissue.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Standing {
    /// Nothing.
    #[default]
    Nothing,
    /// A level wall below where the grip is as it is set.
    Wall,
    /// A spring to where the grip is as it is set.
    Coupling,
}

impl Standing {
    const ALL: [Standing; 3] = [Standing::Nothing, Standing::Wall, Standing::Coupling];

    fn word(self) -> &'static str {
        match self {
            Standing::Nothing => "none",
            Standing::Wall => "wall",
            Standing::Coupling => "coupling",
        }
    }

    /// As a console is told whose grip is here \[m\].
    pub fn fixture(self, grip_m: [f32; 3]) -> Fixture {
        let [x, y, z] = grip_m;
        match self {
            Standing::Nothing => Fixture::None,
            Standing::Wall => Fixture::Wall {
                point_m: [x, y, z - WALL_BELOW_M],
                normal: [0.0, 0.0, 1.0],
                stiffness_n_per_m: FIXTURE_N_PER_M,
                damping_n_s_per_m: FIXTURE_N_S_PER_M,
            },
            Standing::Coupling => Fixture::Coupling {
                anchor_m: [x, y, z],
                stiffness_n_per_m: FIXTURE_N_PER_M,
                damping_n_s_per_m: FIXTURE_N_S_PER_M,
            },
        }
    }
}

/// Renderings that a scene's tissue has.
fn renderings(scene: &Scene) -> impl Iterator<Item = Rendering> {
    // Where tools stick there is no compliance to make rows of.
    let has_rows = scene.tissue.sticking().is_none();
    let all = RENDERINGS.into_iter();
    all.filter(move |rendering| has_rows || *rendering != Rendering::Rows)
}

/// What changes while a session goes on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Change {
    /// How often it is solved, and what is rendered from that.
    Tuning(Tuning),
    /// How the hand holds the grip.
    Grasp(Grasp),
    /// What stands beside the tissue.
    Standing(Standing),
}

/// How a hand holds a grip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grasp {
    /// To where it wants it \[N/m\].
    pub stiffness_n_per_m: f32,
    /// Of its speed against that \[N s/m\].
    pub damping_n_s_per_m: f32,
}

/// Something that can be set.
#[derive(Clone, Debug, PartialEq)]
pub struct Setting {
    name: &'static str,
    range: Choice,
}

/// From what it is chosen.
#[derive(Clone, Debug, PartialEq)]
enum Choice {
    Word {
        value: &'static str,
        choices: Vec<&'static str>,
    },
    Number {
        unit: &'static str,
        value: f64,
        low: f64,
        high: f64,
        step: f64,
    },
}

impl Setting {
    /// All of a session of this plan, that a wish has led to, and whose scene is this file.
    pub fn all(wish: &Wish, scene: &Scene, plan: &Plan, document: &Document) -> Vec<Setting> {
        let number = |name, unit, value, [low, high, step]: [f64; 3]| Setting {
            name,
            range: Choice::Number {
                unit,
                value,
                low,
                high,
                step,
            },
        };
        let (stiffness, damping) = (plan.hand.stiffness_n_per_m, plan.hand.damping_n_s_per_m);
        let mut all = vec![
            Setting {
                name: RENDERING,
                range: Choice::Word {
                    value: plan.rendering.word(),
                    choices: renderings(scene).map(Rendering::word).collect(),
                },
            },
            number(HOST_HZ, "Hz", plan.host_hz, [25.0, 1000.0, 5.0]),
            number(STIFFNESS, "N/m", stiffness.into(), [50.0, 3000.0, 10.0]),
            number(DAMPING, "N s/m", damping.into(), [0.0, 60.0, 0.5]),
            Setting {
                name: FIXTURE,
                range: Choice::Word {
                    value: wish.standing.word(),
                    choices: Standing::ALL.map(Standing::word).to_vec(),
                },
            },
        ];
        for written in written(document) {
            let value = wish.written.get(written.name).copied();
            let value = value.unwrap_or(written.value);
            all.push(number(written.name, written.unit, value, written.ends()));
        }
        all
    }

    /// Its name.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// Whether a session goes on with another value; else that makes another session.
    fn is_at_once(&self) -> bool {
        AT_ONCE.contains(&self.name)
    }

    /// What a session does at once to have another value; none where that needs another solver.
    pub fn change(&self, wish: &Wish, plan: &Plan) -> Option<Change> {
        match self.name {
            RENDERING | HOST_HZ => {
                let Tuning { host_hz, rendering } = plan.tuning();
                Some(Change::Tuning(Tuning {
                    host_hz: wish.host_hz.unwrap_or(host_hz),
                    rendering: wish.rendering.unwrap_or(rendering),
                }))
            }
            STIFFNESS | DAMPING => Some(Change::Grasp(Grasp {
                stiffness_n_per_m: wish
                    .hand_stiffness_n_per_m
                    .unwrap_or(plan.hand.stiffness_n_per_m),
                damping_n_s_per_m: wish
                    .hand_damping_n_s_per_m
                    .unwrap_or(plan.hand.damping_n_s_per_m),
            })),
            FIXTURE => Some(Change::Standing(wish.standing)),
            _ => None,
        }
    }

    /// It has this value now.
    pub fn take(&mut self, to: &SetTo) {
        match (&mut self.range, to) {
            (Choice::Word { value, choices }, SetTo::Word(word)) => {
                let mut named = choices.iter().filter(|each| *each == word);
                *value = named.next().unwrap_or(value);
            }
            (Choice::Number { value, .. }, SetTo::Number(number)) => *value = *number,
            _ => {}
        }
    }

    /// As `hello` says it.
    pub fn said(&self) -> Value {
        match &self.range {
            Choice::Word { value, choices } => {
                json!({"name": self.name, "at_once": self.is_at_once(), "unit": "", "value": value, "choices": choices})
            }
            Choice::Number {
                unit,
                value,
                low,
                high,
                step,
            } => {
                json!({"name": self.name, "at_once": self.is_at_once(), "unit": unit, "value": value, "low": low, "high": high, "step": step})
            }
        }
    }

    /// What is wrong with a value of it, and what to give instead.
    pub fn flaw(&self, to: &SetTo) -> Option<(String, String)> {
        let name = self.name;
        match (&self.range, to) {
            (Choice::Word { choices, .. }, SetTo::Word(word))
                if choices.contains(&word.as_str()) =>
            {
                None
            }
            (Choice::Word { choices, .. }, _) => {
                let help = format!("give one of {}", choices.join(", "));
                Some((format!("that is none of what `{name}` can be"), help))
            }
            (Choice::Number { low, high, .. }, SetTo::Number(value))
                if (*low..=*high).contains(value) =>
            {
                None
            }
            (
                Choice::Number {
                    unit, low, high, ..
                },
                to,
            ) => {
                let message = match to {
                    SetTo::Number(value) => format!("`{name}` is {value} {unit}"),
                    SetTo::Word(_) => format!("`{name}` is a number"),
                };
                Some((message, format!("give {low} to {high} {unit}")))
            }
        }
    }
}

impl Wish {
    /// The same with another value of a setting, which has no flaw.
    pub fn with(&self, setting: &Setting, to: &SetTo) -> Wish {
        let mut wish = self.clone();
        match (setting.name, to) {
            (FIXTURE, SetTo::Word(word)) => {
                let mut named = Standing::ALL.into_iter().filter(|each| each.word() == word);
                wish.standing = named.next().unwrap_or_default();
            }
            (_, SetTo::Word(word)) => {
                let mut named = RENDERINGS.into_iter().filter(|each| each.word() == word);
                wish.rendering = named.next();
            }
            (HOST_HZ, SetTo::Number(value)) => wish.host_hz = Some(*value),
            (STIFFNESS, SetTo::Number(value)) => wish.hand_stiffness_n_per_m = Some(*value as f32),
            (DAMPING, SetTo::Number(value)) => wish.hand_damping_n_s_per_m = Some(*value as f32),
            (name, SetTo::Number(value)) => {
                wish.written.insert(name, *value);
            }
        }
        wish
    }
}

/// A number that a scene's file says.
struct Written {
    name: &'static str,
    unit: &'static str,
    value: f64,
    /// More is refused.
    most: f64,
    /// Where it stands in the text.
    place: Range<usize>,
}

impl Written {
    /// Least and largest to choose, and the step.
    fn ends(&self) -> [f64; 3] {
        let [low, high] = match self.name {
            RATIO => [0.0, LARGEST_RATIO],
            FRICTION if self.value > 0.0 => [0.0, FARTHEST * self.value],
            FRICTION => [0.0, SOME_FRICTION_N_PER_M],
            _ => [self.value / FARTHEST, FARTHEST * self.value],
        };
        let high = high.min(self.most);
        let step = if self.name == RATIO {
            0.01
        } else {
            self.value / 50.0
        };
        [low, high, if step > 0.0 { step } else { 1.0 }]
    }
}

const MODULUS: &str = "youngs-modulus";
const RATIO: &str = "poisson-ratio";
const FRICTION: &str = "needle-friction";
const PUNCTURE: &str = "needle-puncture";

/// What is read of a file.
#[derive(Deserialize)]
struct File {
    tissue: Option<TissueOfFile>,
}

#[derive(Deserialize)]
struct TissueOfFile {
    youngs_modulus_pa: Option<Spanned<f64>>,
    poisson_ratio: Option<Spanned<f64>>,
    needle: Option<NeedleOfFile>,
}

#[derive(Deserialize)]
struct NeedleOfFile {
    friction_n_per_m: Option<Spanned<f64>>,
    static_friction_n_per_m: Option<Spanned<f64>>,
    puncture_pa: Option<Spanned<f64>>,
}

/// What a file says that can be set; nothing if it is none.
fn written(document: &Document) -> Vec<Written> {
    let file = toml::from_str::<File>(document.text()).ok();
    let Some(tissue) = file.and_then(|file| file.tissue) else {
        return Vec::new();
    };
    let needle = tissue.needle.as_ref();
    let at_rest = needle.and_then(|needle| needle.static_friction_n_per_m.as_ref());
    let at_rest = at_rest.map_or(f64::INFINITY, |value| *value.get_ref());
    let friction = needle.and_then(|needle| needle.friction_n_per_m.as_ref());
    let puncture = needle.and_then(|needle| needle.puncture_pa.as_ref());
    let each = [
        (
            MODULUS,
            "Pa",
            tissue.youngs_modulus_pa.as_ref(),
            f64::INFINITY,
        ),
        (RATIO, "", tissue.poisson_ratio.as_ref(), f64::INFINITY),
        (FRICTION, "N/m", friction, at_rest),
        (PUNCTURE, "Pa", puncture, f64::INFINITY),
    ];
    let each = each.into_iter().filter_map(|(name, unit, value, most)| {
        let value = value?;
        Some(Written {
            name,
            unit,
            value: *value.get_ref(),
            most,
            place: value.span(),
        })
    });
    each.collect()
}

/// A scene's file with other numbers in their places.
pub fn edited(document: Document, numbers: &BTreeMap<&'static str, f64>) -> Document {
    let mut places: Vec<_> = written(&document)
        .into_iter()
        .filter_map(|written| Some((written.place, *numbers.get(written.name)?)))
        .collect();
    // From the end on: those before stay where they are.
    places.sort_by_key(|(place, _)| std::cmp::Reverse(place.start));
    let mut text = document.text().to_owned();
    for (place, value) in places {
        text.replace_range(place, &format!("{value:?}"));
    }
    document.with_text(text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;
    use sutura_shared::wire::Message;

    fn document() -> Document {
        let text = "\
[tissue]
model = \"linear\" # of the gut
youngs_modulus_pa = 150e3
poisson_ratio = 0.45
needle = { friction_n_per_m = 25.0, static_friction_n_per_m = 30, puncture_pa = 1e6 }

[[region]]
youngs_modulus_pa = 1
";
        Document::embedded("scene.toml", Path::new(""), text)
    }

    #[test]
    fn what_the_file_says_is_written_anew_in_its_place() {
        let numbers = BTreeMap::from([(MODULUS, 2e5), (FRICTION, 12.5), ("unknown", 1.0)]);
        let edited = edited(document(), &numbers);
        let lines: Vec<&str> = edited.text().lines().collect();
        let [model, modulus, ratio, needle] = [lines[1], lines[2], lines[3], lines[4]];
        assert_eq!(model, "model = \"linear\" # of the gut");
        assert_eq!(modulus, "youngs_modulus_pa = 200000.0");
        assert_eq!(ratio, "poisson_ratio = 0.45");
        assert_eq!(
            needle,
            "needle = { friction_n_per_m = 12.5, static_friction_n_per_m = 30, puncture_pa = 1e6 }"
        );
        assert_eq!(lines[7], "youngs_modulus_pa = 1");
    }

    #[test]
    fn a_wall_stands_below_the_grip_and_a_coupling_holds_it() {
        let setting = Setting {
            name: FIXTURE,
            range: Choice::Word {
                value: "none",
                choices: Standing::ALL.map(Standing::word).to_vec(),
            },
        };
        let of = |word: &str| {
            let to = SetTo::Word(word.to_owned());
            assert_eq!(setting.flaw(&to), None);
            let standing = Wish::default().with(&setting, &to).standing;
            let fixture = standing.fixture([0.01, 0.02, 0.03]);
            assert_eq!(fixture.check(), Ok(()));
            fixture
        };
        assert_eq!(of("none"), Fixture::None);
        let Fixture::Wall { point_m, .. } = of("wall") else {
            panic!("a wall");
        };
        assert_eq!(point_m, [0.01, 0.02, 0.03 - WALL_BELOW_M]);
        let Fixture::Coupling { anchor_m, .. } = of("coupling") else {
            panic!("a coupling");
        };
        assert_eq!(anchor_m, [0.01, 0.02, 0.03]);
        let wrong = setting.flaw(&SetTo::Word("floor".to_owned()));
        assert!(wrong.is_some_and(|(_, help)| help == "give one of none, wall, coupling"));
    }

    #[test]
    fn only_what_is_written_can_be_set_and_only_so_far() {
        let all = written(&document());
        let ends: Vec<_> = all.iter().map(|each| (each.name, each.ends())).collect();
        assert_eq!(
            ends,
            [
                (MODULUS, [15e3, 1.5e6, 3e3]),
                (RATIO, [0.0, LARGEST_RATIO, 0.01]),
                (FRICTION, [0.0, 30.0, 0.5]),
                (PUNCTURE, [1e5, 1e7, 2e4]),
            ]
        );
        let none = Document::embedded("scene.toml", Path::new(""), "[tissue]\nmodel = \"linear\"");
        assert!(written(&none).is_empty());
    }
}
