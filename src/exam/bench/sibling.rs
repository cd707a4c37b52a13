//! Other vehicles of a bench's type.

use super::Bench;
use crate::exam::draw::Draw;
use crate::exam::programme::{Restriction, Vigour, programme};

impl Bench {
    /// Another vehicle of the type: its own build and flights, with the same kind of link, loop and
    /// log.
    pub(in crate::exam) fn sibling(&self, draw: &mut Draw) -> Self {
        let vigour = Vigour::draw(draw, self.nominal.rotor_radius_m);
        let motions = programme(draw, &vigour, Restriction::None, self.motions.len(), self.seconds);
        let mut configs = self.configs.clone();
        configs.iter_mut().for_each(|config| config.battery.charge = draw.within([0.45, 1.0]));
        Self {
            nominal: self.nominal.clone(),
            believed: self.believed.clone(),
            deviations: self.deviations.of_sibling(draw),
            setting: self.setting.clone(),
            world: self.world,
            configs,
            rates: self.rates,
            link: self.link,
            motions,
            seconds: self.seconds,
            ratios: self.ratios,
            seed: draw.seed(),
            notes: Vec::new(),
            trap: None,
        }
    }
}
