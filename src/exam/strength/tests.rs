use sitl::config::SitlConfig;

use super::*;
use crate::exam::airframe;
use crate::exam::draw::Draw;
use crate::exam::flight::{Link, Sortie};
use crate::exam::ground::Rates;
use crate::exam::programme::{Restriction, Vigour, programme};

#[test]
fn nominal_flight_is_predicted_and_an_effect_stands_out() {
    let mut draw = Draw::new(2, 0);
    let mut nominal = airframe::vehicle(&mut draw, "quad");
    // Without a delay there is no jitter, so the test is deterministic.
    nominal.command_delay_s = 0.0;
    let vigour = Vigour::draw(&mut draw, nominal.rotor_radius_m);
    let motions = programme(&mut draw, &vigour, Restriction::None, 2, 8.0);
    let noise = SensorConfig::default();
    let nothing = EffectSet::new();
    let model = Model {
        believed: &nominal,
        body: &nominal,
        effects: &nothing,
        foreign: &[],
        trim: Attitude::default(),
        outputs_hz: None,
    };
    let predictor = Predictor::new(&model, noise).expect("a vehicle");
    let errors = |argument: Option<&str>| {
        let mut effects = EffectSet::new();
        argument.into_iter().for_each(|text| effects.insert_argument(text).expect("an effect"));
        let fly = |motion| {
            let sortie = Sortie {
                believed: &nominal,
                body: &nominal,
                effects: &effects,
                foreign: &[],
                config: SitlConfig { sensors: SensorConfig::IDEAL, ..SitlConfig::default() },
                rates: Rates {
                    attitude: 250.0,
                    imu: 100.0,
                    position: 100.0,
                    outputs: 100.0,
                    battery: 5.0,
                    rpm: 0.0,
                },
                link: Link { delay_s: 1.5e-3, jitter_s: 1e-3, offset_s: 5.0, skew: 1e-5 },
                motion,
                seconds: 8.0,
                seed: 3,
            };
            sortie.fly().expect("a flight").track
        };
        let tracks: Vec<Track> = motions.iter().map(fly).collect();
        predictor.errors(&tracks, &effects, 1)
    };
    let (null, none) = (errors(None), Errors::default());
    assert!(null.strength(&none).ratio < 1e-3, "{:?}", null.strength(&none));
    let weak = errors(Some("thrust_scale:scale=0.99")).strength(&null);
    let strong = errors(Some("thrust_scale:scale=0.98")).strength(&null);
    assert!((strong.ratio / weak.ratio - 2.0).abs() < 0.2, "{weak:?} {strong:?}");
    assert!(strong.channel.contains('z'), "{strong:?}");
}
