//! Device files: one console each, in TOML, with units in the key names.
//!
//! Entry points: [`find_device`] (by name or path, as a scene says it) and [`read_device`].
//! What the numbers mean to the control loop: [`sutura_shared::device`].

use super::document::{Document, SceneError, nearest};
use std::path::Path;
use sutura_scene_file::device::{DeviceFile, PrismaticSection, RevoluteSection};
use sutura_shared::control::TICK_HZ;
use sutura_shared::device::{DeviceDescription, JOINTS, Joint, Kinematics, MAX_ACTUATION_DELAY_US};
use toml::Spanned;

/// A console, as its file has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Device {
    /// What its control loop knows.
    pub description: DeviceDescription,
    /// Frames of 24 rows and their contacts that its board has time for in a second \[Hz\]; none if the file does not say.
    pub board_rows_hz: Option<f64>,
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
    let name = value.get_ref();
    if name.ends_with(".toml") {
        let path = scene.resolve(name);
        if !scene.has_file(&path) {
            let message = format!("there is no device file {}", path.display());
            let help = "paths are relative to the scene file; a name without `.toml` is looked up in devices/";
            return Err(scene.flaw(value.span(), message, "no such file", Some(help)));
        }
        return read_device(&scene.open(&path)?);
    }
    let plain = !name.is_empty() && !name.contains(['/', '\\']);
    for folder in ["devices", "../devices"] {
        let path = scene.resolve(folder).join(format!("{name}.toml"));
        if plain && scene.has_file(&path) {
            return read_device(&scene.open(&path)?);
        }
    }
    if let Some((_, text)) = BUILT_IN.iter().find(|(known, _)| known == name) {
        return read_device(&Document::embedded(
            &format!("{name}.toml"),
            Path::new(""),
            text,
        ));
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
    let file = DeviceFile::read(document.text()).map_err(|error| document.unread(&error))?;
    let c = Check(document);
    let mut name = [0; 16];
    let written = file.name.get_ref().as_bytes();
    if written.is_empty() || written.len() > name.len() {
        let message = format!("name `{}`: must have 1 to 16 bytes", file.name.get_ref());
        let help = "the name travels in fixed fields of the handshake";
        return Err(document.flaw(file.name.span(), message, "1 to 16 bytes", Some(help)));
    }
    name[..written.len()].copy_from_slice(written);
    let max_force_n = c.positive("max_force_n", &file.max_force_n)?;
    let max_power_w = c.positive("max_power_w", &file.max_power_w)?;
    let max_grip_speed_m_per_s =
        c.positive("max_grip_speed_m_per_s", &file.max_grip_speed_m_per_s)?;
    let actuation_delay_us = c.delay("actuation_delay_us", &file.actuation_delay_us)?;
    let board_rows_hz = c.rows_hz("board_rows_hz", file.board_rows_hz.as_ref())?;
    let (kinematics, joints, gravity_mass_kg) = match (file.cartesian, file.serial_arm) {
        (Some(section), None) => {
            let section = section.into_inner();
            let kinematics = Kinematics::Cartesian {
                origin_m: c.vector("origin_m", &section.origin_m)?,
            };
            let (joints, gravity_mass_kg) = prismatic(&c, &section.joint)?;
            (kinematics, joints, gravity_mass_kg)
        }
        (None, Some(section)) => {
            let section = section.into_inner();
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
            (kinematics, joints, gravity_mass_kg)
        }
        (first, second) => {
            let both = first.is_some() && second.is_some();
            let span = second.map_or_else(|| file.name.span(), |s| s.span());
            let message = if both {
                "two kinds of kinematics"
            } else {
                "no kinematics"
            };
            let help = "a device has either a `[cartesian]` or a `[serial_arm]` section";
            return Err(document.flaw(span, message, "one section is needed", Some(help)));
        }
    };
    Ok(Device {
        description: DeviceDescription {
            name,
            kinematics,
            joints,
            gravity_mass_kg,
            max_force_n,
            max_power_w,
            max_grip_speed_m_per_s,
            actuation_delay_us,
        },
        board_rows_hz,
    })
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
