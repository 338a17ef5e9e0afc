//! Device files: one console each, in TOML, with units in the key names.
//!
//! Entry points: [`find_device`] (by name or path, as a scene says it) and [`read_device`].
//! What the numbers mean to the control loop: [`sutura_shared::device`].

use super::document::{Document, Flaw, SceneError, nearest};
use super::units::of_encoders;
use std::ops::Range;
use std::path::Path;
use sutura_scene_file::device::{DeviceFile, PrismaticSection, RevoluteSection};
use sutura_shared::control::TICK_HZ;
use sutura_shared::device::{
    DeviceDescription, DeviceError, JOINTS, Joint, Kinematics, MAX_ACTUATION_DELAY_US,
};
use sutura_shared::wire::validate;
use toml::Spanned;

/// A console, as its file has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Device {
    /// What its control loop knows.
    pub description: DeviceDescription,
    /// Frames of 24 rows and their contacts that its board has time for in a second \[Hz\]; none if the file does not say.
    pub board_rows_hz: Option<f64>,
    /// Lowest and highest coordinate of each joint between its stops \[m or rad\], (3); none if the file does not say.
    pub travel: [Option<[f64; 2]>; JOINTS],
}

/// Devices that are known by name wherever the program runs.
pub const BUILT_IN: [(&str, &str); 2] = [
    (
        "cartesian-bench",
        include_str!("../../../devices/cartesian-bench.toml"),
    ),
    (
        "serial-arm",
        include_str!("../../../devices/serial-arm.toml"),
    ),
];

/// The device that a scene names: a path when it ends in `.toml`, else `devices/NAME.toml` next to the
/// scene or beside its directory, else a built-in one.
///
/// # Errors
/// A flaw at `value` for a name nobody knows, or whatever is wrong in the device's own file.
pub fn find_device(scene: &Document, value: &Spanned<String>) -> Result<Device, SceneError> {
    read_device(&device_document(scene, value)?)
}

/// The same, with warnings at the keys of the device's own file.
///
/// # Errors
/// As [`find_device`].
pub(super) fn find_device_warned(
    scene: &Document,
    value: &Spanned<String>,
) -> Result<(Device, Vec<Flaw>), SceneError> {
    read_warned(&device_document(scene, value)?)
}

/// The file of the device that a scene names.
fn device_document(scene: &Document, value: &Spanned<String>) -> Result<Document, SceneError> {
    let name = value.get_ref();
    if name.ends_with(".toml") {
        let path = scene.resolve(name);
        if !scene.has_file(&path) {
            let message = format!("there is no device file {}", path.display());
            let help = "paths are relative to the scene file; a name without `.toml` is looked up in devices/";
            return Err(scene.flaw(value.span(), message, "no such file", Some(help)));
        }
        return scene.open(&path);
    }
    let plain = !name.is_empty() && !name.contains(['/', '\\']);
    for folder in ["devices", "../devices"] {
        let path = scene.resolve(folder).join(format!("{name}.toml"));
        if plain && scene.has_file(&path) {
            return scene.open(&path);
        }
    }
    if let Some((_, text)) = BUILT_IN.iter().find(|(known, _)| known == name) {
        let file = format!("{name}.toml");
        return Ok(Document::embedded(&file, Path::new(""), text));
    }
    let known = BUILT_IN.map(|(known, _)| known);
    let all = known.map(|k| format!("`{k}`")).join(", ");
    let help = match nearest(name, &known) {
        Some(near) => {
            format!("did you mean `{near}`? Known: {all}, or give the path of a .toml file")
        }
        None => format!("known: {all}, or give the path of a .toml file"),
    };
    let message = format!("unknown device `{name}`");
    Err(scene.flaw(value.span(), message, "no such device", Some(&help)))
}

/// The device of a scene that names none.
///
/// # Errors
/// None unless what is built in is not sound.
pub fn built_in_device() -> Result<Device, SceneError> {
    let (name, text) = BUILT_IN[0];
    read_device(&Document::embedded(name, Path::new(""), text))
}

/// Reads a device file.
///
/// # Errors
/// A flaw at the key or the number that is wrong.
pub fn read_device(document: &Document) -> Result<Device, SceneError> {
    Ok(read_warned(document)?.0)
}

/// Reads a device file; warnings are of values that are hardly meant.
fn read_warned(document: &Document) -> Result<(Device, Vec<Flaw>), SceneError> {
    let file = DeviceFile::read(document.text()).map_err(|error| document.unread(&error))?;
    let c = Check(document);
    let name = read_name(document, &file.name)?;
    let max_force_n = c.positive("max_force_n", &file.max_force_n)?;
    let max_power_w = c.positive("max_power_w", &file.max_power_w)?;
    let max_grip_speed_m_per_s =
        c.positive("max_grip_speed_m_per_s", &file.max_grip_speed_m_per_s)?;
    let actuation_delay_us = c.delay("actuation_delay_us", &file.actuation_delay_us)?;
    let board_rows_hz = c.rows_hz("board_rows_hz", file.board_rows_hz.as_ref())?;
    let (kinematics, joints, gravity_mass_kg, travel) = match (&file.cartesian, &file.serial_arm) {
        (Some(section), None) => {
            let section = section.get_ref();
            let kinematics = Kinematics::Cartesian {
                origin_m: c.vector("origin_m", &section.origin_m)?,
            };
            let (joints, gravity_mass_kg) = prismatic(&c, &section.joint)?;
            let each = c.three(&section.joint)?.each_ref();
            let travel = c.travel("travel_m", each.map(|joint| joint.travel_m.as_ref()))?;
            (kinematics, joints, gravity_mass_kg, travel)
        }
        (None, Some(section)) => {
            let section = section.get_ref();
            let kinematics = Kinematics::SerialArm {
                shoulder_m: c.vector("shoulder_m", &section.shoulder_m)?,
                upper_m: c.positive("upper_m", &section.upper_m)?,
                fore_m: c.positive("fore_m", &section.fore_m)?,
            };
            let gravity_mass_kg = [
                0.0,
                c.not_negative("elbow_mass_kg", &section.elbow_mass_kg)?,
                c.not_negative("grip_mass_kg", &section.grip_mass_kg)?,
            ];
            let joints = revolute(&c, &section.joint)?;
            let each = c.three(&section.joint)?.each_ref();
            let travel = c.travel("travel_rad", each.map(|joint| joint.travel_rad.as_ref()))?;
            (kinematics, joints, gravity_mass_kg, travel)
        }
        (first, second) => {
            let both = first.is_some() && second.is_some();
            let span = second
                .as_ref()
                .map_or_else(|| file.name.span(), Spanned::span);
            let message = if both {
                "two kinds of kinematics"
            } else {
                "no kinematics"
            };
            let help = "a device has either a `[cartesian]` or a `[serial_arm]` section";
            return Err(document.flaw(span, message, "one section is needed", Some(help)));
        }
    };
    let description = DeviceDescription {
        name,
        kinematics,
        joints,
        gravity_mass_kg,
        max_force_n,
        max_power_w,
        max_grip_speed_m_per_s,
        actuation_delay_us,
    };
    description
        .validate()
        .map_err(|error| unusable(document, &file, error))?;
    let device = Device {
        description,
        board_rows_hz,
        travel,
    };
    Ok((device, of_encoders(document, &file)))
}

/// The name, padded with zeros as it travels.
fn read_name(document: &Document, said: &Spanned<String>) -> Result<[u8; 16], SceneError> {
    let mut name = [0; 16];
    let (text, written) = (said.get_ref(), said.get_ref().as_bytes());
    let help = "the name travels in fixed fields of the handshake";
    if written.is_empty() || written.len() > name.len() {
        let message = format!("name `{}`: must have 1 to 16 bytes", text.escape_debug());
        return Err(document.flaw(said.span(), message, "1 to 16 bytes", Some(help)));
    }
    name[..written.len()].copy_from_slice(written);
    // Zeros at its end are lost on the wire.
    if validate::name(&name) != Ok(text) {
        let message = format!(
            "name `{}`: must have no control characters",
            text.escape_debug()
        );
        let help = "consoles refuse it: it is printed on terminals; take letters, digits and `-`";
        return Err(document.flaw(said.span(), message, "a control character", Some(help)));
    }
    Ok(name)
}

/// Refuses, at its key, a value that no console can compute with.
fn unusable(document: &Document, file: &DeviceFile, error: DeviceError) -> SceneError {
    let keys = keys(file);
    let is_it = |key: &&Key| key.field == error.field && key.joint == error.joint;
    // A message about all joints together stands at the first.
    let first = |key: &&Key| key.field == error.field;
    let found = keys.iter().find(is_it).or(keys.iter().find(first));
    let (name, value, span) = match found {
        Some(key) => (key.name, key.value.clone(), key.span.clone()),
        None => (error.field, String::new(), file.name.span()),
    };
    let message = format!("{name}{value}: must be {}", error.rule);
    let help = "no console computes with that: see the device's data sheets, the unit is in the key's name";
    document.flaw(span, message, format!("must be {}", error.rule), Some(help))
}

/// A key of a device file that becomes a field of its description.
struct Key {
    field: &'static str,
    joint: Option<u8>,
    name: &'static str,
    /// ` = ` and what it says; nothing of a vector.
    value: String,
    span: Range<usize>,
}

impl Key {
    fn of(field: &'static str, name: &'static str, said: &Spanned<f64>) -> Self {
        Self {
            field,
            joint: None,
            name,
            value: format!(" = {}", said.get_ref()),
            span: said.span(),
        }
    }

    fn place(field: &'static str, said: &Spanned<[f64; 3]>) -> Self {
        Self {
            field,
            joint: None,
            name: field,
            value: String::new(),
            span: said.span(),
        }
    }

    fn of_joint(self, index: u8) -> Self {
        Self {
            joint: Some(index),
            ..self
        }
    }
}

/// All of them; masses before all that concerns a joint alone, since a description says of them together what is wrong.
fn keys(file: &DeviceFile) -> Vec<Key> {
    let mut keys = vec![
        Key::of("max_force_n", "max_force_n", &file.max_force_n),
        Key::of("max_power_w", "max_power_w", &file.max_power_w),
        Key::of(
            "max_grip_speed_m_per_s",
            "max_grip_speed_m_per_s",
            &file.max_grip_speed_m_per_s,
        ),
    ];
    // The heaviest, of which the limit is one for all.
    let heaviest = |masses: Vec<(&'static str, &Spanned<f64>)>| {
        let masses = masses.into_iter();
        let most = masses.max_by(|a, b| a.1.get_ref().total_cmp(b.1.get_ref()));
        most.map(|(name, mass)| Key::of("gravity_mass_kg", name, mass))
    };
    if let Some(section) = file.cartesian.as_ref().map(Spanned::get_ref) {
        keys.push(Key::place("origin_m", &section.origin_m));
        let joints = section.joint.get_ref();
        let masses = joints
            .iter()
            .map(|j| ("carried_mass_kg", &j.carried_mass_kg));
        keys.extend(heaviest(masses.collect()));
        for (index, j) in (0u8..).zip(joints) {
            let own = [
                Key::of("counts_per_unit", "counts_per_m", &j.counts_per_m),
                Key::of("effort_per_amp", "force_n_per_a", &j.force_n_per_a),
                Key::of("max_current_a", "max_current_a", &j.max_current_a),
                Key::of("max_slew_per_s", "max_slew_n_per_s", &j.max_slew_n_per_s),
                Key::of("max_speed_per_s", "max_speed_m_per_s", &j.max_speed_m_per_s),
                Key::of("inertia", "mass_kg", &j.mass_kg),
                Key::of("damping", "damping_n_s_per_m", &j.damping_n_s_per_m),
                Key::of("coulomb", "coulomb_n", &j.coulomb_n),
            ];
            keys.extend(own.map(|key| key.of_joint(index)));
        }
    }
    if let Some(section) = file.serial_arm.as_ref().map(Spanned::get_ref) {
        keys.extend([
            Key::place("shoulder_m", &section.shoulder_m),
            Key::of("upper_m", "upper_m", &section.upper_m),
            Key::of("fore_m", "fore_m", &section.fore_m),
        ]);
        let masses = vec![
            ("elbow_mass_kg", &section.elbow_mass_kg),
            ("grip_mass_kg", &section.grip_mass_kg),
        ];
        keys.extend(heaviest(masses));
        for (index, j) in (0u8..).zip(section.joint.get_ref()) {
            let own = [
                Key::of("counts_per_unit", "counts_per_rad", &j.counts_per_rad),
                Key::of("effort_per_amp", "torque_nm_per_a", &j.torque_nm_per_a),
                Key::of("max_current_a", "max_current_a", &j.max_current_a),
                Key::of("max_slew_per_s", "max_slew_nm_per_s", &j.max_slew_nm_per_s),
                Key::of(
                    "max_speed_per_s",
                    "max_speed_rad_per_s",
                    &j.max_speed_rad_per_s,
                ),
                Key::of("inertia", "inertia_kg_m2", &j.inertia_kg_m2),
                Key::of("damping", "damping_nm_s_per_rad", &j.damping_nm_s_per_rad),
                Key::of("coulomb", "coulomb_nm", &j.coulomb_nm),
            ];
            keys.extend(own.map(|key| key.of_joint(index)));
        }
    }
    keys
}

fn prismatic(
    c: &Check<'_>,
    sections: &Spanned<Vec<PrismaticSection>>,
) -> Result<([Joint; JOINTS], [f32; JOINTS]), SceneError> {
    let [x, y, z] = c.three(sections)?;
    let joint = |j: &PrismaticSection| -> Result<Joint, SceneError> {
        Ok(Joint {
            counts_per_unit: c.not_zero("counts_per_m", &j.counts_per_m)?,
            zero_counts: j.zero_counts,
            effort_per_amp: c.not_zero("force_n_per_a", &j.force_n_per_a)?,
            max_current_a: c.positive("max_current_a", &j.max_current_a)?,
            max_slew_per_s: c.positive("max_slew_n_per_s", &j.max_slew_n_per_s)?,
            max_speed_per_s: c.positive("max_speed_m_per_s", &j.max_speed_m_per_s)?,
            inertia: c.positive("mass_kg", &j.mass_kg)?,
            damping: c.not_negative("damping_n_s_per_m", &j.damping_n_s_per_m)?,
            coulomb: c.not_negative("coulomb_n", &j.coulomb_n)?,
        })
    };
    let carried = |j: &PrismaticSection| c.not_negative("carried_mass_kg", &j.carried_mass_kg);
    Ok((
        [joint(x)?, joint(y)?, joint(z)?],
        [carried(x)?, carried(y)?, carried(z)?],
    ))
}

fn revolute(
    c: &Check<'_>,
    sections: &Spanned<Vec<RevoluteSection>>,
) -> Result<[Joint; JOINTS], SceneError> {
    let [yaw, shoulder, elbow] = c.three(sections)?;
    let joint = |j: &RevoluteSection| -> Result<Joint, SceneError> {
        Ok(Joint {
            counts_per_unit: c.not_zero("counts_per_rad", &j.counts_per_rad)?,
            zero_counts: j.zero_counts,
            effort_per_amp: c.not_zero("torque_nm_per_a", &j.torque_nm_per_a)?,
            max_current_a: c.positive("max_current_a", &j.max_current_a)?,
            max_slew_per_s: c.positive("max_slew_nm_per_s", &j.max_slew_nm_per_s)?,
            max_speed_per_s: c.positive("max_speed_rad_per_s", &j.max_speed_rad_per_s)?,
            inertia: c.positive("inertia_kg_m2", &j.inertia_kg_m2)?,
            damping: c.not_negative("damping_nm_s_per_rad", &j.damping_nm_s_per_rad)?,
            coulomb: c.not_negative("coulomb_nm", &j.coulomb_nm)?,
        })
    };
    Ok([joint(yaw)?, joint(shoulder)?, joint(elbow)?])
}

/// Checks numbers and rounds them to what the console computes with.
struct Check<'a>(&'a Document);

impl Check<'_> {
    fn number(
        &self,
        key: &str,
        value: &Spanned<f64>,
        rule: &str,
        ok: impl Fn(f32) -> bool,
    ) -> Result<f32, SceneError> {
        let fits = |v: f64| (v as f32).is_finite() && ok(v as f32);
        let help = "the unit is in the key's name; the console computes in single precision";
        Ok(self.0.number(key, value, rule, fits, help)? as f32)
    }

    fn positive(&self, key: &str, value: &Spanned<f64>) -> Result<f32, SceneError> {
        self.number(key, value, "positive", |v| v > 0.0)
    }

    fn not_negative(&self, key: &str, value: &Spanned<f64>) -> Result<f32, SceneError> {
        self.number(key, value, "zero or positive", |v| v >= 0.0)
    }

    fn not_zero(&self, key: &str, value: &Spanned<f64>) -> Result<f32, SceneError> {
        self.number(
            key,
            value,
            "other than zero; its sign is the direction",
            |v| v != 0.0,
        )
    }

    fn delay(&self, key: &str, value: &Spanned<u32>) -> Result<u32, SceneError> {
        let delay_us = *value.get_ref();
        if delay_us > MAX_ACTUATION_DELAY_US {
            let message = format!("{key} = {delay_us}: must be at most {MAX_ACTUATION_DELAY_US}");
            let help = "a current acts one tick (1000 us) after it was computed on most drives";
            return Err(self.0.flaw(value.span(), message, "too long", Some(help)));
        }
        Ok(delay_us)
    }

    /// A rate up to that of the ticks, if there is one.
    fn rows_hz(&self, key: &str, value: Option<&Spanned<f64>>) -> Result<Option<f64>, SceneError> {
        let most = f64::from(TICK_HZ);
        let rule = format!("above 0, at most {most}");
        let help = "what the self-test's line `rows_a_second` says of the board; left out, the line alone limits rows";
        let fits = |hz: f64| hz > 0.0 && hz <= most;
        value
            .map(|value| self.0.number(key, value, &rule, fits, help))
            .transpose()
    }

    fn vector(&self, key: &str, value: &Spanned<[f64; 3]>) -> Result<[f32; 3], SceneError> {
        Ok(self.0.finite(key, value)?.map(|v| v as f32))
    }

    /// Stops of the joints, the lower one first.
    fn travel(
        &self,
        key: &str,
        values: [Option<&Spanned<[f64; 2]>>; JOINTS],
    ) -> Result<[Option<[f64; 2]>; JOINTS], SceneError> {
        let mut travel = [None; JOINTS];
        for (travel, value) in travel.iter_mut().zip(values) {
            let Some(value) = value else {
                continue;
            };
            let [low, high] = self.0.finite(key, value)?;
            if low >= high {
                let message = format!("{key} = [{low}, {high}]: the lower stop comes first");
                let help = "the joint's coordinates at its two stops, in the unit of the key";
                return Err(self.0.flaw(value.span(), message, "no travel", Some(help)));
            }
            *travel = Some([low, high]);
        }
        Ok(travel)
    }

    fn three<'s, T>(&self, sections: &'s Spanned<Vec<T>>) -> Result<&'s [T; JOINTS], SceneError> {
        sections.get_ref().as_slice().try_into().map_err(|_| {
            let message = format!(
                "{} joints: a console has {JOINTS}",
                sections.get_ref().len()
            );
            let help = "give one `joint` section for each, from the base out";
            self.0
                .flaw(sections.span(), message, "needs three", Some(help))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use miette::Diagnostic;

    fn built_in(name: &str) -> String {
        let found = BUILT_IN.iter().find(|(known, _)| *known == name);
        found
            .expect("the test names a built-in device")
            .1
            .to_owned()
    }

    fn complaint(text: &str) -> (String, String) {
        let error = read_device(&Document::embedded("device.toml", Path::new(""), text))
            .expect_err("the test gives a bad file");
        let help = error.help().map(|h| h.to_string()).unwrap_or_default();
        (error.to_string(), help)
    }

    #[test]
    fn built_in_devices_read_and_keep_their_names() {
        for (name, text) in BUILT_IN {
            let device = read_device(&Document::embedded(name, Path::new(""), text));
            let device = device.expect("built-in devices are good").description;
            assert_eq!(&device.name[..name.len()], name.as_bytes());
            assert!(device.name[name.len()..].iter().all(|b| *b == 0));
        }
    }

    #[test]
    fn a_bad_number_and_a_bad_key_are_named() {
        let text = built_in("cartesian-bench");
        let (message, _) = complaint(&text.replacen("mass_kg = ", "mass_kg = -", 1));
        assert!(message.starts_with("mass_kg = -"), "{message}");
        assert!(message.ends_with("must be positive"), "{message}");
        let (message, _) = complaint(&text.replacen("delay_us = 1000", "delay_us = 5001", 1));
        assert_eq!(message, "actuation_delay_us = 5001: must be at most 5000");
        let slow = text.replacen("[cartesian]", "board_rows_hz = 0.0\n[cartesian]", 1);
        let (message, help) = complaint(&slow);
        assert_eq!(message, "board_rows_hz = 0: must be above 0, at most 1000");
        assert!(help.contains("rows_a_second"), "{help}");
        let (message, help) = complaint(&text.replacen("coulomb_n ", "coulomb_nm ", 1));
        assert!(message.contains("unknown key `coulomb_nm`"), "{message}");
        assert!(help.contains("did you mean `coulomb_n`"), "{help}");
    }

    /// A name that a console refuses is refused at its key, in a message without terminal escapes.
    #[test]
    fn names_that_a_console_refuses_are_refused_at_the_key() {
        let text = built_in("cartesian-bench");
        for (name, said) in [
            ("\\u001b[31mx", "control characters"),
            ("a\\tb", "control characters"),
            ("bench\\u0000", "control characters"),
            ("", "1 to 16 bytes"),
            ("seventeen-letters", "1 to 16 bytes"),
        ] {
            let named = text.replacen("\"cartesian-bench\"", &format!("\"{name}\""), 1);
            let (message, _) = complaint(&named);
            assert!(
                message.starts_with("name `") && message.contains(said),
                "{message}"
            );
            assert!(!message.chars().any(char::is_control), "{message:?}");
        }
        let named = text.replacen("\"cartesian-bench\"", "\"Prüfstand 2\"", 1);
        read_device(&Document::embedded("device.toml", Path::new(""), &named)).expect("a name");
    }

    /// Every number of a device file, far too large, far too small, at nothing and with the other sign: it is refused at its place, or a
    /// console takes the device.
    #[test]
    fn what_is_read_a_console_takes() {
        use sutura_shared::wire::Message;
        use sutura_shared::wire::message::Simulate;
        let (mut refused, mut taken) = (0, 0);
        let mut check = |name: &str, text: &str, place: Range<usize>, changed: f64| {
            let edited = format!("{}{changed:?}{}", &text[..place.start], &text[place.end..]);
            let read = read_device(&Document::embedded(name, Path::new(""), &edited));
            match read {
                Ok(device) => {
                    taken += 1;
                    let simulated = Simulate::Device(device.description);
                    assert_eq!(
                        simulated.check(),
                        Ok(()),
                        "{changed} in {name} at {place:?}"
                    );
                    assert_eq!(device.description.validate(), Ok(()));
                }
                Err(SceneError::Flaw(_)) => refused += 1,
                Err(other) => panic!("{other}"),
            }
        };
        for (name, text) in BUILT_IN {
            let mut offset = 0;
            for line in text.lines() {
                let start = offset;
                offset += line.len() + 1;
                let Some((_, value)) = line.split_once(" = ") else {
                    continue;
                };
                let Ok(number) = value.parse::<f64>() else {
                    continue;
                };
                let place = start + line.len() - value.len();
                for changed in [1e-12, 1e-3, 1e3, 1e12].map(|times| times * number) {
                    check(name, text, place..place + value.len(), changed);
                }
                for changed in [0.0, -number] {
                    check(name, text, place..place + value.len(), changed);
                }
            }
        }
        assert!(
            refused > 50 && taken > 50,
            "{refused} refused, {taken} taken"
        );
    }

    /// Counts for a millimetre or a degree are warned of at their key, with what they were meant to be; shipped devices are not.
    #[test]
    fn encoders_in_another_unit_are_warned_of() {
        let warned = |text: &str| {
            let document = Document::embedded("device.toml", Path::new(""), text);
            let (_, warned) = read_warned(&document).expect("good");
            let said = warned.iter().map(|flaw| {
                let place = flaw.span();
                let under = &text[place.offset()..place.offset() + place.len()];
                let help = flaw.help().map(|help| help.to_string());
                (under.to_owned(), flaw.to_string(), help.unwrap_or_default())
            });
            said.collect::<Vec<_>>()
        };
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../devices");
        for entry in std::fs::read_dir(folder).expect("there") {
            let text = std::fs::read_to_string(entry.expect("readable").path()).expect("text");
            assert!(warned(&text).is_empty(), "{:?}", warned(&text));
        }
        let bench = built_in("cartesian-bench");
        let said = warned(&bench.replacen("= 81487.0", "= -81.487", 1));
        let expected = (
            "-81.487".to_owned(),
            "joint 0: counts_per_m = -81.487: a step of 12.3 mm, larger than 100.0 um".to_owned(),
            "counts per metre are asked for: times 1000 it is 12.3 um".to_owned(),
        );
        assert_eq!(said, [expected]);
        assert_eq!(warned(&bench.replace("= 81487.0", "= 81.487")).len(), 3);
        // Just the largest, and so coarse that no unit helps.
        assert!(warned(&bench.replace("= 81487.0", "= 10000.0")).is_empty());
        let said = warned(&bench.replacen("= 81487.0", "= 8.15", 1));
        assert_eq!(said[0].2, "counts per metre are asked for");
        // By the arm's length: 0.44 m at the shoulder, 0.22 m at the elbow.
        let arm = built_in("serial-arm");
        let said = warned(&arm.replace("= 12732.0", "= 222.2"));
        let [yaw, _, elbow] = said.as_slice() else {
            panic!("{said:?}")
        };
        assert!(yaw.1.contains("a step of 2.0 mm"), "{yaw:?}");
        assert!(elbow.1.contains("a step of 990.1 um"), "{elbow:?}");
        let help = "counts per radian are asked for: times 57.3 it is 17.3 um";
        assert_eq!(elbow.2, help);
        assert_eq!(warned(&arm.replace("= 12732.0", "= 3000.0")).len(), 2);
    }

    #[test]
    fn stops_are_two_numbers_in_order() {
        let text = built_in("cartesian-bench");
        let device = read_device(&Document::embedded("device.toml", Path::new(""), &text));
        assert_eq!(device.expect("good").travel, [Some([-0.11, 0.11]); 3]);
        let (message, _) = complaint(&text.replacen("[-0.11, 0.11]", "[0.11, -0.11]", 1));
        assert_eq!(
            message,
            "travel_m = [0.11, -0.11]: the lower stop comes first"
        );
        let arm = read_device(&Document::embedded(
            "arm.toml",
            Path::new(""),
            &built_in("serial-arm"),
        ));
        assert_eq!(arm.expect("good").travel, [None; 3]);
    }

    #[test]
    fn a_device_has_three_joints_and_one_kind_of_kinematics() {
        let text = built_in("cartesian-bench");
        let first = text.find("[[cartesian.joint]]").expect("has joints");
        let second = first
            + 1
            + text[first + 1..]
                .find("[[cartesian.joint]]")
                .expect("has two");
        let (message, _) = complaint(&text.replacen(&text[first..second], "", 1));
        assert_eq!(message, "2 joints: a console has 3");
        let (message, _) = complaint(
            "name = \"bare\"\nmax_force_n = 1.0\nmax_power_w = 1.0\nmax_grip_speed_m_per_s = 1.0\nactuation_delay_us = 0\n",
        );
        assert_eq!(message, "no kinematics");
    }
}
