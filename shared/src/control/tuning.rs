//! What is rendered, and which guards watch over it.
//!
//! Entry point: [`Tuning`]. A console that is used has the default; everything else is for measuring.

/// What the force between two frames is taken from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Rendering {
    /// The last frame's force.
    Hold,
    /// The last two frames' forces, on a straight line in time (Picinbono and Lombardo 1999).
    LinearTime,
    /// The last frame's tangent, with gap and relaxation (Otaduy and Lin 2006).
    Tangent,
    /// The frame's contact rows (Saupin, Duriez and Cotin 2008); the tangent where there are none or
    /// they do not converge.
    #[default]
    Rows,
}

/// Guards, on or off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Guards {
    /// A swap of models is blended.
    pub blend: bool,
    /// The tangent is corrected by what successive frames say of it, and trusted less as it ages.
    pub trust: bool,
    /// The force is evaluated where the grip will be when the motors act.
    pub lead: bool,
    /// Surfaces are curved: the tangent changes along the way as it has changed, and rows end sideways.
    pub bend: bool,
    /// The lead grows while a grip in contact swings.
    pub swing: bool,
    /// The passivity observer's tank bounds what is given back.
    pub tank: bool,
    /// The tank goes by way and stiffness along the force; without, by those of the axes.
    pub along: bool,
    /// A force that an outage has taken away comes back at a bounded rate, on credit.
    pub credit: bool,
    /// The passivity controller adds damping.
    pub damping: bool,
    /// Contact data beyond its horizon decays.
    pub horizon: bool,
    /// Force is limited, per axis and in total.
    pub force: bool,
    /// Slew is limited.
    pub slew: bool,
    /// Power is limited.
    pub power: bool,
    /// A grip that is too fast is a fault.
    pub overspeed: bool,
    /// Rows whose residual is too large give way to the tangent.
    pub residual: bool,
    /// Friction holds back what a needle has gone in since its frame.
    pub rubs: bool,
    /// A pressed emergency stop is a fault.
    pub emergency_stop: bool,
    /// An encoder that moves faster than the device can is a fault.
    pub encoder_jump: bool,
    /// An encoder that changes its pace faster than anything moves is a fault.
    pub encoder_burst: bool,
    /// A new session disarms and forgets.
    pub disarm: bool,
}

impl Guards {
    /// All of them.
    pub const ALL: Guards = Guards {
        blend: true,
        trust: true,
        lead: true,
        bend: true,
        swing: true,
        tank: true,
        along: true,
        credit: true,
        damping: true,
        horizon: true,
        force: true,
        slew: true,
        power: true,
        overspeed: true,
        residual: true,
        rubs: true,
        emergency_stop: true,
        encoder_jump: true,
        encoder_burst: true,
        disarm: true,
    };

    /// Their names.
    pub const NAMES: [&str; 20] = [
        "blend",
        "trust",
        "lead",
        "bend",
        "swing",
        "tank",
        "along",
        "credit",
        "damping",
        "horizon",
        "force",
        "slew",
        "power",
        "overspeed",
        "residual",
        "rubs",
        "emergency_stop",
        "encoder_jump",
        "encoder_burst",
        "disarm",
    ];

    /// Switches off the guard of this name, that of its field; false if there is none.
    pub fn switch_off(&mut self, name: &str) -> bool {
        let guard = match name {
            "blend" => &mut self.blend,
            "trust" => &mut self.trust,
            "lead" => &mut self.lead,
            "bend" => &mut self.bend,
            "swing" => &mut self.swing,
            "tank" => &mut self.tank,
            "along" => &mut self.along,
            "credit" => &mut self.credit,
            "damping" => &mut self.damping,
            "horizon" => &mut self.horizon,
            "force" => &mut self.force,
            "slew" => &mut self.slew,
            "power" => &mut self.power,
            "overspeed" => &mut self.overspeed,
            "residual" => &mut self.residual,
            "rubs" => &mut self.rubs,
            "emergency_stop" => &mut self.emergency_stop,
            "encoder_jump" => &mut self.encoder_jump,
            "encoder_burst" => &mut self.encoder_burst,
            "disarm" => &mut self.disarm,
            _ => return false,
        };
        *guard = false;
        true
    }
}

impl Default for Guards {
    fn default() -> Self {
        Guards::ALL
    }
}

/// How a console renders.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tuning {
    /// What the force is taken from.
    pub rendering: Rendering,
    /// What watches over it.
    pub guards: Guards,
}
