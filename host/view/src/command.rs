//! What clients say: the first message, and commands.
//!
//! Entry points: [`First::read`], [`Command::read`]. Nothing is obeyed that is not understood to the last key.

use serde_json::{Map, Value};

/// Version of the format that this server speaks.
pub const FORMAT: u64 = 1;
/// Largest number that every JavaScript program can count to.
const MOST_ID: u64 = 1 << 53;
/// Farther than this no console reaches \[m\].
const FARTHEST_M: f64 = 10.0;

/// The first message.
#[derive(Clone, Debug, PartialEq)]
pub struct First {
    /// The key.
    pub key: String,
    /// Whether the client would like to control.
    pub control: bool,
    /// The format that it speaks.
    pub format: u64,
}

impl First {
    /// Reads it; `None` if it is none.
    pub fn read(text: &str) -> Option<Self> {
        let Value::Object(mut map) = serde_json::from_str(text).ok()? else {
            return None;
        };
        let first = Self {
            key: map.remove("key")?.as_str()?.to_owned(),
            control: map.remove("control")?.as_bool()?,
            format: map.remove("format")?.as_u64()?,
        };
        map.is_empty().then_some(first)
    }
}

/// What a client asks for.
#[derive(Clone, Debug, PartialEq)]
pub enum Command {
    /// It has taken the picture of this sequence.
    Ack(u32),
    /// Pictures a second that it wants \[Hz\].
    PictureHz(f64),
    /// The scalar that it wants.
    Scalar(Option<String>),
    /// It takes the controls.
    TakeControl,
    /// Disarm, at once.
    SafeStop,
    /// Arm.
    Arm,
    /// Clear latched faults.
    ClearFault,
    /// Disarm, move the grip out of the tissue by the shortest way, arm.
    TakeOut,
    /// Take the grip there \[m\]; `None`: let it go.
    Drag(Option<[f64; 3]>),
    /// The scene's hand from its start, or none.
    Hand(Hand),
    /// Close the jaws of the console's tool, or open them.
    Jaws(bool),
    /// Stop time.
    Pause,
    /// Let it go on.
    Resume,
    /// So many ticks, then pause.
    StepTicks(u32),
    /// So many solves, then pause.
    StepSolves(u32),
    /// Session time per wall time.
    Speed(f64),
    /// From the start.
    Reset,
    /// Another scene.
    Scene(String),
    /// Another tissue.
    Tissue(String),
    /// A setting.
    Set {
        /// Its name.
        name: String,
        /// What it shall be.
        value: SetTo,
    },
    /// Begin anew and record it, or end the recording.
    Record(bool),
    /// Write the last seconds to a file.
    SaveLast,
    /// The picture of a recording at this time \[s\].
    Seek(f64),
}

/// What a setting shall be.
#[derive(Clone, Debug, PartialEq)]
pub enum SetTo {
    /// In the setting's unit.
    Number(f64),
    /// One of those that the setting has.
    Word(String),
}

/// Which hand holds the grip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hand {
    /// That of the scene.
    Scene,
    /// As it was dragged last.
    Recorded,
    /// None that moves.
    Still,
}

/// Why a message is not understood.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refused {
    /// Its id, if it has one.
    pub id: u64,
    /// What is wrong.
    pub message: String,
    /// What to do.
    pub help: String,
}

impl Refused {
    /// With its next step.
    pub fn new(id: u64, message: impl Into<String>, help: impl Into<String>) -> Self {
        Self {
            id,
            message: message.into(),
            help: help.into(),
        }
    }
}

const HELP: &str = "the book's page \"The page's format\" lists all commands and their keys";

/// The keys that are left of a command.
struct Keys {
    map: Map<String, Value>,
    id: u64,
    name: String,
}

impl Keys {
    fn flaw(&self, key: &str, wants: &str) -> Refused {
        let message = format!("`{}` wants `{key}`: {wants}", self.name);
        Refused::new(self.id, message, HELP)
    }

    fn number(&mut self, key: &str, low: f64, high: f64) -> Result<f64, Refused> {
        let value = self.map.remove(key).and_then(|value| value.as_f64());
        let value = value.filter(|value| (low..=high).contains(value));
        value.ok_or_else(|| self.flaw(key, &format!("a number from {low} to {high}")))
    }

    fn whole(&mut self, key: &str, low: u32, high: u32) -> Result<u32, Refused> {
        let value = self.map.remove(key).and_then(|value| value.as_u64());
        let value = value.and_then(|value| u32::try_from(value).ok());
        let value = value.filter(|value| (low..=high).contains(value));
        value.ok_or_else(|| self.flaw(key, &format!("a whole number from {low} to {high}")))
    }

    fn text(&mut self, key: &str) -> Result<String, Refused> {
        let value = self.map.remove(key);
        let text = value.and_then(|value| value.as_str().map(str::to_owned));
        text.ok_or_else(|| self.flaw(key, "a text"))
    }

    fn yes_or_no(&mut self, key: &str) -> Result<bool, Refused> {
        let value = self.map.remove(key).and_then(|value| value.as_bool());
        value.ok_or_else(|| self.flaw(key, "true or false"))
    }

    /// A value that must be there, and may be null.
    fn or_null(&mut self, key: &str, wants: &str) -> Result<Option<Value>, Refused> {
        match self.map.remove(key) {
            None => Err(self.flaw(key, wants)),
            Some(Value::Null) => Ok(None),
            Some(value) => Ok(Some(value)),
        }
    }
}

impl Command {
    /// Reads a command and its id.
    ///
    /// # Errors
    /// What of it is not understood.
    pub fn read(text: &str) -> Result<(u64, Self), Refused> {
        let value = serde_json::from_str(text);
        let Ok(Value::Object(mut map)) = value else {
            return Err(Refused::new(0, "a message is no JSON object", HELP));
        };
        let name = map
            .remove("do")
            .and_then(|name| name.as_str().map(str::to_owned));
        let id = match map.remove("id") {
            // A picture is acknowledged without an answer.
            None if name.as_deref() == Some("ack") => Some(0),
            id => id.and_then(|id| id.as_u64()).filter(|id| *id <= MOST_ID),
        };
        let Some(id) = id else {
            return Err(Refused::new(
                0,
                "a command has no `id` that is a whole number",
                HELP,
            ));
        };
        let Some(name) = name else {
            return Err(Refused::new(id, "a message has no `do`", HELP));
        };
        let mut keys = Keys { map, id, name };
        let command = Self::of(&mut keys)?;
        match keys.map.keys().next() {
            None => Ok((id, command)),
            Some(key) => {
                let message = format!("`{}` has no key `{key}`", keys.name);
                Err(Refused::new(id, message, HELP))
            }
        }
    }

    fn of(keys: &mut Keys) -> Result<Self, Refused> {
        Ok(match keys.name.as_str() {
            "ack" => Self::Ack(keys.whole("sequence", 0, u32::MAX)?),
            "picture_hz" => Self::PictureHz(keys.number("hz", 0.0, 60.0)?),
            "scalar" => Self::Scalar(match keys.or_null("name", "a text, or null")? {
                None => None,
                Some(Value::String(name)) => Some(name),
                Some(_) => return Err(keys.flaw("name", "a text, or null")),
            }),
            "take_control" => Self::TakeControl,
            "safe_stop" => Self::SafeStop,
            "arm" => Self::Arm,
            "clear_fault" => Self::ClearFault,
            "take_out" => Self::TakeOut,
            "drag" => Self::Drag(drag(keys)?),
            "hand" => Self::Hand(match keys.text("way")?.as_str() {
                "scene" => Hand::Scene,
                "recorded" => Hand::Recorded,
                "none" => Hand::Still,
                _ => return Err(keys.flaw("way", "`scene`, `recorded` or `none`")),
            }),
            "jaws" => Self::Jaws(keys.yes_or_no("closed")?),
            "pause" => Self::Pause,
            "resume" => Self::Resume,
            "step" if keys.map.contains_key("solves") => {
                Self::StepSolves(keys.whole("solves", 1, 1000)?)
            }
            "step" => Self::StepTicks(keys.whole("ticks", 1, 10_000)?),
            "speed" => Self::Speed(keys.number("factor", 0.01, 4.0)?),
            "reset" => Self::Reset,
            "scene" => Self::Scene(keys.text("name")?),
            "tissue" => Self::Tissue(keys.text("name")?),
            "set" => Self::Set {
                name: keys.text("name")?,
                value: set_to(keys)?,
            },
            "record" => Self::Record(keys.yes_or_no("on")?),
            "save_last" => Self::SaveLast,
            "seek" => Self::Seek(keys.number("time_s", 0.0, 1e9)?),
            other => {
                let message = format!("there is no command `{other}`");
                return Err(Refused::new(keys.id, message, HELP));
            }
        })
    }

    /// Its name.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Ack(_) => "ack",
            Self::PictureHz(_) => "picture_hz",
            Self::Scalar(_) => "scalar",
            Self::TakeControl => "take_control",
            Self::SafeStop => "safe_stop",
            Self::Arm => "arm",
            Self::ClearFault => "clear_fault",
            Self::TakeOut => "take_out",
            Self::Drag(_) => "drag",
            Self::Hand(_) => "hand",
            Self::Jaws(_) => "jaws",
            Self::Pause => "pause",
            Self::Resume => "resume",
            Self::StepTicks(_) | Self::StepSolves(_) => "step",
            Self::Speed(_) => "speed",
            Self::Reset => "reset",
            Self::Scene(_) => "scene",
            Self::Tissue(_) => "tissue",
            Self::Set { .. } => "set",
            Self::Record(_) => "record",
            Self::SaveLast => "save_last",
            Self::Seek(_) => "seek",
        }
    }

    /// Whether only who controls may ask for it.
    pub fn takes_control(&self) -> bool {
        !matches!(
            self,
            Self::Ack(_)
                | Self::PictureHz(_)
                | Self::Scalar(_)
                | Self::TakeControl
                | Self::SafeStop
                | Self::Seek(_)
        )
    }
}

fn set_to(keys: &mut Keys) -> Result<SetTo, Refused> {
    let value = keys.map.remove("value");
    let to = value.and_then(|value| match value {
        Value::Number(number) => number.as_f64().map(SetTo::Number),
        Value::String(word) => Some(SetTo::Word(word)),
        _ => None,
    });
    to.ok_or_else(|| keys.flaw("value", "a number, or a text"))
}

fn drag(keys: &mut Keys) -> Result<Option<[f64; 3]>, Refused> {
    const WANTS: &str = "three numbers from -10 to 10, or null";
    let Some(value) = keys.or_null("to_m", WANTS)? else {
        return Ok(None);
    };
    let numbers: Option<Vec<f64>> = value
        .as_array()
        .and_then(|list| list.iter().map(Value::as_f64).collect());
    let place = numbers.and_then(|numbers| <[f64; 3]>::try_from(numbers).ok());
    let place = place.filter(|place| place.iter().all(|x| x.abs() <= FARTHEST_M));
    place.map(Some).ok_or_else(|| keys.flaw("to_m", WANTS))
}
