//! Supply voltage and temperatures, from voltages that a converter reads.
//!
//! Entry points, once a tick: [`Supply::is_unfit`] or [`Supply::tick`], [`Thermistor::tick`]. `embedded-hal` 1.0 has no trait for converters any more, so that
//! [`Channel`] is our own: one reading of one channel, as boards and converters on a bus can give it.

/// One channel of a converter.
pub trait Channel {
    /// Reading at full scale.
    const FULL_SCALE: u16;
    /// Why there is no reading.
    type Error;

    /// A reading, 0 to [`Self::FULL_SCALE`], that was begun before: it may not wait.
    ///
    /// # Errors
    /// The converter's.
    fn read(&mut self) -> Result<u16, Self::Error>;
}

/// A reading as a part of full scale; none where it is at either end, which an open or shorted line gives, or there is none.
fn part<C: Channel>(channel: &mut C) -> Option<f32> {
    let reading = channel.read().ok()?;
    // A hundredth from either end: a converter's offset and gain are worse than a count.
    let part = f32::from(reading) / f32::from(C::FULL_SCALE);
    (part > 0.01 && part < 0.99).then_some(part)
}

/// The motors' supply, behind a divider.
#[derive(Debug)]
pub struct Supply<C> {
    channel: C,
    /// Voltage at full scale \[V\].
    full_scale_v: f32,
    /// Below the first it is low, above the second it is well again, above the third too high \[V\].
    limits_v: [f32; 3],
    low: bool,
    /// The last three readings \[V\]; the middle one counts.
    last_v: [Option<f32>; 3],
}

/// A motors' supply as a board has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorSupply {
    /// Voltage at which the converter reads full scale: its reference, over the divider's part \[V\].
    pub full_scale_v: f32,
    /// Low below the first, well again above the second, too high above the third \[V\].
    pub limits_v: [f32; 3],
}

/// What a supply is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SupplyState {
    /// Within its limits \[V\].
    Well(f32),
    /// Too low, or was and is not yet well above \[V\].
    Low(f32),
    /// Too high, as motors that are driven from outside make it \[V\].
    High(f32),
    /// Nobody can say.
    Unknown,
}

impl<C: Channel> Supply<C> {
    /// A supply on a channel.
    pub fn new(channel: C, own: MotorSupply) -> Self {
        Self {
            channel,
            full_scale_v: own.full_scale_v,
            limits_v: own.limits_v,
            low: true,
            last_v: [None; 3],
        }
    }

    /// Once a tick: whether motors that are wanted may not have it. While nobody wants them it may be anything, off too.
    pub fn is_unfit(&mut self, wanted: bool) -> bool {
        let state = self.tick();
        wanted && !matches!(state, SupplyState::Well(_))
    }

    /// A reading, and what the last three come to: a single one that is off changes nothing, and a supply that fails is seen 2 ms
    /// later.
    pub fn tick(&mut self) -> SupplyState {
        let [newest, before, _] = self.last_v;
        self.last_v = [
            part(&mut self.channel).map(|part| part * self.full_scale_v),
            newest,
            before,
        ];
        let Some(volts) = median(self.last_v) else {
            self.low = true;
            return SupplyState::Unknown;
        };
        let [low, well, high] = self.limits_v;
        self.low = volts < if self.low { well } else { low };
        if self.low {
            SupplyState::Low(volts)
        } else if volts > high {
            SupplyState::High(volts)
        } else {
            SupplyState::Well(volts)
        }
    }
}

/// The middle one of three; none if two of them are missing.
fn median(values: [Option<f32>; 3]) -> Option<f32> {
    match values {
        [Some(a), Some(b), Some(c)] => {
            let (low, high) = if a < b { (a, b) } else { (b, a) };
            Some(if c < low {
                low
            } else if c > high {
                high
            } else {
                c
            })
        }
        // With one missing the lower one: the supply is judged by it.
        [Some(a), Some(b), None] | [Some(a), None, Some(b)] | [None, Some(a), Some(b)] => {
            Some(if a < b { a } else { b })
        }
        _ => None,
    }
}

/// A thermistor of 10 kOhm at 25 degrees Celsius and B = 3950 K from the channel to ground, with 10 kOhm from the channel to the
/// converter's reference.
#[derive(Debug)]
pub struct Thermistor<C> {
    channel: C,
}

/// Part of full scale and temperature \[degrees Celsius\]: R / (R + 10 kOhm) with R = 10 kOhm exp(3950 K (1/T - 1/298.15 K)). On straight
/// lines between them it is within 0.5 degrees.
const CURVE: [(f32, f32); 15] = [
    (0.91333, -20.0),
    (0.85347, -10.0),
    (0.77075, 0.0),
    (0.66860, 10.0),
    (0.55625, 20.0),
    (0.44559, 30.0),
    (0.34647, 40.0),
    (0.26407, 50.0),
    (0.19911, 60.0),
    (0.14965, 70.0),
    (0.11271, 80.0),
    (0.08539, 90.0),
    (0.06520, 100.0),
    (0.05025, 110.0),
    (0.03912, 120.0),
];

impl<C: Channel> Thermistor<C> {
    /// A thermistor on a channel.
    pub fn new(channel: C) -> Self {
        Self { channel }
    }

    /// Temperature \[degrees Celsius\]; none below -20 and above 120, and where the line is open or shorted.
    pub fn tick(&mut self) -> Option<f32> {
        let part = part(&mut self.channel)?;
        CURVE.windows(2).find_map(|pair| {
            let &[(warm, from), (cold, to)] = pair else {
                return None;
            };
            (part <= warm && part >= cold)
                .then(|| from + (to - from) * (warm - part) / (warm - cold))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    /// A channel of 12 bits with these readings, the first one last; `None` = the converter fails.
    struct Script(Vec<Option<u16>>);

    impl Channel for Script {
        const FULL_SCALE: u16 = 4095;
        type Error = ();

        fn read(&mut self) -> Result<u16, ()> {
            self.0.pop().expect("as many readings as ticks").ok_or(())
        }
    }

    fn script(readings: impl IntoIterator<Item = Option<u16>>) -> Script {
        let mut readings: Vec<_> = readings.into_iter().collect();
        readings.reverse();
        Script(readings)
    }

    /// 30 V at full scale; low below 20 V, well above 22 V, too high above 28 V.
    fn states(volts: &[Option<f32>]) -> Vec<SupplyState> {
        let readings = volts
            .iter()
            .map(|volts| volts.map(|volts| (volts / 30.0 * 4095.0 + 0.5) as u16));
        let mut supply = Supply::new(script(readings), OWN);
        volts.iter().map(|_| supply.tick()).collect()
    }

    const OWN: MotorSupply = MotorSupply {
        full_scale_v: 30.0,
        limits_v: [20.0, 22.0, 28.0],
    };

    #[test]
    fn a_supply_that_is_off_or_unknown_matters_to_motors_that_are_wanted_and_to_no_others() {
        let reading = |volts: f32| Some((volts / 30.0 * 4095.0) as u16);
        // Off, on, too high, a broken wire: three ticks each.
        let states = [reading(0.5), reading(24.0), reading(29.0), None];
        let readings = states.iter().flat_map(|state| [*state; 3]);
        for wanted in [false, true] {
            let mut supply = Supply::new(script(readings.clone()), OWN);
            let unfit: Vec<_> = (0..12).map(|_| supply.is_unfit(wanted)).collect();
            let settled = [unfit[2], unfit[5], unfit[8], unfit[11]];
            assert_eq!(settled, [wanted, false, wanted, wanted]);
        }
    }

    fn kinds(volts: &[Option<f32>]) -> std::string::String {
        let kind = |state: &SupplyState| match state {
            SupplyState::Well(_) => 'w',
            SupplyState::Low(_) => 'l',
            SupplyState::High(_) => 'h',
            SupplyState::Unknown => '?',
        };
        states(volts).iter().map(kind).collect()
    }

    #[test]
    fn a_supply_is_low_below_one_limit_and_well_above_another() {
        let volts = [
            24.0, 24.0, 24.0, 21.0, 21.0, 19.0, 19.0, 21.0, 21.0, 21.0, 23.0, 23.0, 29.0, 29.0,
        ];
        // The middle of three: seen with the second reading.
        assert_eq!(kinds(&volts.map(Some)), "?wwwwwlllllwwh");
        assert!(
            matches!(states(&[Some(24.0); 3])[2], SupplyState::Well(v) if (v - 24.0).abs() < 0.01)
        );
    }

    #[test]
    fn one_reading_that_is_off_changes_nothing_and_two_do() {
        let well = Some(24.0);
        for off in [None, Some(0.0), Some(30.0), Some(1.0), Some(29.0)] {
            assert_eq!(
                kinds(&[well, well, well, off, well, well, well]),
                "?wwwwww",
                "{off:?}"
            );
        }
        for (off, kind) in [
            (None, "??"),
            (Some(0.0), "??"),
            (Some(30.0), "??"),
            (Some(1.0), "ll"),
            (Some(29.0), "hh"),
        ] {
            let found = kinds(&[well, well, well, off, off, off]);
            assert_eq!(&found[4..], kind, "{off:?}");
        }
    }

    #[test]
    fn an_unknown_supply_must_be_well_to_be_well_again() {
        let volts = [
            Some(24.0),
            Some(24.0),
            None,
            None,
            Some(21.0),
            Some(21.0),
            Some(21.0),
            Some(23.0),
            Some(23.0),
        ];
        assert_eq!(kinds(&volts), "?ww??lllw");
    }

    /// Against the formula, over the whole range.
    #[test]
    fn a_temperature_is_within_half_a_degree() {
        for tenth in -199..1199_i32 {
            let celsius = f64::from(tenth) / 10.0;
            let ratio = (3950.0 * (1.0 / (celsius + 273.15) - 1.0 / 298.15)).exp();
            let reading = (ratio / (1.0 + ratio) * 4095.0).round() as u16;
            let found = Thermistor::new(script([Some(reading)])).tick();
            let found = found.expect("in range");
            // And what a count is at the hot end.
            let count = if celsius > 80.0 { 0.5 } else { 0.1 };
            assert!(
                (f64::from(found) - celsius).abs() < 0.6 + count,
                "{celsius}: {found}"
            );
        }
    }

    #[test]
    fn no_temperature_of_an_open_or_shorted_line() {
        for reading in [None, Some(0), Some(30), Some(4080), Some(4095)] {
            assert_eq!(
                Thermistor::new(script([reading])).tick(),
                None,
                "{reading:?}"
            );
        }
    }
}
