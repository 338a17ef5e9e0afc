//! What a device file may say, key by key. Units are in the names; unknown keys are refused.
//!
//! Entry point: [`DeviceFile::read`]. Values are checked where they are used.

use serde::Deserialize;
use toml::Spanned;

/// A whole device file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DeviceFile {
    /// 1 to 16 bytes.
    pub name: Spanned<String>,
    /// Largest contact force at the grip \[N\].
    pub max_force_n: Spanned<f64>,
    /// Largest mechanical power of the contact force \[W\].
    pub max_power_w: Spanned<f64>,
    /// A grip that stays faster is a fault \[m/s\].
    pub max_grip_speed_m_per_s: Spanned<f64>,
    /// From the tick that computes a current until it acts \[us\].
    pub actuation_delay_us: Spanned<u32>,
    /// Frames of 24 rows and their contacts that the board has time for in a second \[Hz\].
    pub board_rows_hz: Option<Spanned<f64>>,
    /// Three orthogonal stages.
    pub cartesian: Option<Spanned<CartesianSection>>,
    /// Yaw, shoulder, elbow.
    pub serial_arm: Option<Spanned<SerialArmSection>>,
}

/// `[cartesian]`: three orthogonal stages along x, y, z.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CartesianSection {
    /// Grip position where all joints read 0 \[m\], (3).
    pub origin_m: Spanned<[f64; 3]>,
    /// From the base out, (3).
    pub joint: Spanned<Vec<PrismaticSection>>,
}

/// A stage of `[cartesian]`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PrismaticSection {
    /// Encoder, with its sign.
    pub counts_per_m: Spanned<f64>,
    /// Encoder where the joint reads 0.
    #[serde(default)]
    pub zero_counts: i32,
    /// Motor and gear, with its sign \[N/A\].
    pub force_n_per_a: Spanned<f64>,
    /// Of motor or amplifier \[A\].
    pub max_current_a: Spanned<f64>,
    /// Fastest change of effort \[N/s\].
    pub max_slew_n_per_s: Spanned<f64>,
    /// A faster jump of the encoder is a fault \[m/s\].
    pub max_speed_m_per_s: Spanned<f64>,
    /// For the virtual console \[kg\].
    pub mass_kg: Spanned<f64>,
    /// For the virtual console \[N s/m\].
    pub damping_n_s_per_m: Spanned<f64>,
    /// Friction, for the virtual console \[N\].
    pub coulomb_n: Spanned<f64>,
    /// Mass that this joint's gravity compensation carries; matters along z only.
    pub carried_mass_kg: Spanned<f64>,
    /// Coordinates of its two stops \[m\], (2): a scene's way points beyond them are warned of.
    pub travel_m: Option<Spanned<[f64; 2]>>,
}

/// `[serial_arm]`: yaw, shoulder, elbow.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SerialArmSection {
    /// Where the shoulder stands \[m\], (3).
    pub shoulder_m: Spanned<[f64; 3]>,
    /// From shoulder to elbow \[m\].
    pub upper_m: Spanned<f64>,
    /// From elbow to grip \[m\].
    pub fore_m: Spanned<f64>,
    /// What gravity compensation carries at the elbow \[kg\].
    pub elbow_mass_kg: Spanned<f64>,
    /// At the grip \[kg\].
    pub grip_mass_kg: Spanned<f64>,
    /// From the base out, (3).
    pub joint: Spanned<Vec<RevoluteSection>>,
}

/// A joint of `[serial_arm]`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RevoluteSection {
    /// Encoder, with its sign.
    pub counts_per_rad: Spanned<f64>,
    /// Encoder where the joint reads 0.
    #[serde(default)]
    pub zero_counts: i32,
    /// Motor and gear, with its sign \[N m/A\].
    pub torque_nm_per_a: Spanned<f64>,
    /// Of motor or amplifier \[A\].
    pub max_current_a: Spanned<f64>,
    /// Fastest change of effort \[N m/s\].
    pub max_slew_nm_per_s: Spanned<f64>,
    /// A faster jump of the encoder is a fault \[rad/s\].
    pub max_speed_rad_per_s: Spanned<f64>,
    /// For the virtual console \[kg m^2\].
    pub inertia_kg_m2: Spanned<f64>,
    /// For the virtual console \[N m s/rad\].
    pub damping_nm_s_per_rad: Spanned<f64>,
    /// Friction, for the virtual console \[N m\].
    pub coulomb_nm: Spanned<f64>,
    /// Coordinates of its two stops \[rad\], (2): a scene's way points beyond them are warned of.
    pub travel_rad: Option<Spanned<[f64; 2]>>,
}

impl DeviceFile {
    /// From a file's text.
    ///
    /// # Errors
    /// What is no TOML, or no device file, and where.
    pub fn read(text: &str) -> Result<DeviceFile, toml::de::Error> {
        toml::from_str(text)
    }
}
