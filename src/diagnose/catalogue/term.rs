//! A term of a law: a coefficient times a product of quantities, acting along axes that are related
//! by the symmetry of the airframe.

use std::collections::BTreeMap;

use vehicle::effects::EffectSet;
use vehicle::law::{Channel, LAWS_MAX, LawText, Quantity, Unit};

/// A free name for a law that was found, beside the vehicle's own laws.
pub fn name_of(effects: &EffectSet) -> String {
    let names = std::iter::once("found".to_owned()).chain((2..).map(|n| format!("found_{n}")));
    let is_free = |name: &String| effects.laws().iter().all(|law| law.name() != name);
    names.take(LAWS_MAX + 1).find(is_free).unwrap_or_default()
}

/// A term without its coefficient.
#[derive(Clone, Debug, PartialEq)]
pub struct Term {
    /// Channels that it acts on, each with its quantity (`None` for 1) and sign.
    pub parts: Vec<(Channel, Option<Quantity>, f64)>,
    /// Common factor of all parts.
    pub factor: Factor,
}

/// The common factor of a term's parts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Factor {
    /// The factor 1.
    One,
    /// A quantity in SI.
    Quantity(Quantity),
    /// A speed divided by 1 m/s, to a power.
    Power(Quantity, f64),
    /// The product of two quantities.
    Product(Quantity, Quantity),
    /// exp(-height / length), the length in m.
    Decay(f64),
    /// The voltage missing from a full pack, as a share.
    Sag,
    /// The sine or the cosine of the heading.
    Heading(bool),
    /// The absolute value of the part's own quantity.
    Own,
}

impl Factor {
    /// The shape parameter that a search refines: its value and bounds.
    pub fn shape(self) -> Option<(f64, [f64; 2])> {
        match self {
            Self::Power(_, power) => Some((power, [-0.8, 3.0])),
            Self::Decay(length) => Some((length, [0.05, 5.0])),
            _ => None,
        }
    }

    /// The same factor with another shape parameter.
    pub fn shaped(self, shape: f64) -> Self {
        match self {
            Self::Power(quantity, _) => Self::Power(quantity, shape),
            Self::Decay(_) => Self::Decay(shape),
            other => other,
        }
    }

    /// The unit of its value.
    fn unit(self) -> Unit {
        let both = |a: Quantity, b: Quantity| a.unit().times(b.unit()).unwrap_or_default();
        match self {
            Self::Quantity(quantity) => quantity.unit(),
            Self::Product(a, b) => both(a, b),
            _ => Unit::NONE,
        }
    }

    /// The quantities that it reads.
    fn quantities(self) -> Vec<Quantity> {
        match self {
            Self::Quantity(quantity) | Self::Power(quantity, _) => vec![quantity],
            Self::Product(a, b) => vec![a, b],
            Self::Decay(_) => vec![Quantity::Height],
            Self::Sag => vec![Quantity::Charge],
            Self::Heading(_) => vec![Quantity::Heading],
            Self::One | Self::Own => Vec::new(),
        }
    }
}

impl Term {
    /// The unit of its coefficient.
    pub fn unit(&self) -> Unit {
        let of_part = |(channel, quantity, _): &(Channel, Option<Quantity>, f64)| {
            let own = quantity.map_or(Unit::NONE, Quantity::unit);
            let squared = if self.factor == Factor::Own { own } else { Unit::NONE };
            let all = own.times(squared)?.times(self.factor.unit())?;
            channel.unit().over(all)
        };
        self.parts.first().and_then(of_part).unwrap_or_default()
    }

    /// The quantities that it reads, each once and in order.
    pub fn quantities(&self) -> Vec<Quantity> {
        let own = self.parts.iter().filter_map(|(_, quantity, _)| *quantity);
        let mut all: Vec<Quantity> = own.chain(self.factor.quantities()).collect();
        all.sort_unstable();
        all.dedup();
        all
    }

    /// The formula of one part, with the given names of its coefficient and its shape.
    fn formula(
        &self,
        (_, quantity, sign): &(Channel, Option<Quantity>, f64),
        [coefficient, shape]: [&str; 2],
    ) -> String {
        let mut text = format!("{}{coefficient}", if *sign < 0.0 { "-" } else { "" });
        let own = quantity.map_or("1", Quantity::name);
        if quantity.is_some() {
            text += &format!(" * {own}");
        }
        text += &match self.factor {
            Factor::One => String::new(),
            Factor::Quantity(quantity) => format!(" * {}", quantity.name()),
            Factor::Power(quantity, _) => format!(" * ({} / 1[m/s])^{shape}", quantity.name()),
            Factor::Product(a, b) => format!(" * {} * {}", a.name(), b.name()),
            Factor::Decay(_) => format!(" * exp(-height / {shape})"),
            Factor::Sag => " * (1 - voltage_share)".to_owned(),
            Factor::Heading(true) => " * sin(heading)".to_owned(),
            Factor::Heading(false) => " * cos(heading)".to_owned(),
            Factor::Own => format!(" * abs({own})"),
        };
        text
    }

    /// The term in one line, with `c` as the coefficient.
    pub fn text(&self) -> String {
        let shape = match self.factor.shape() {
            Some((length, _)) if matches!(self.factor, Factor::Decay(_)) => {
                format!("{length:.3}[m]")
            }
            Some((power, _)) => format!("{power:.3}"),
            None => String::new(),
        };
        let part = |part: &(Channel, Option<Quantity>, f64)| {
            format!("{} = {}", part.0.name(), self.formula(part, ["c", &shape]))
        };
        self.parts.iter().map(part).collect::<Vec<_>>().join("; ")
    }
}

/// The law of these terms and coefficients; `None` without a term.
pub fn law_of<'a>(terms: impl IntoIterator<Item = (&'a Term, f64)>) -> Option<LawText> {
    let mut law = LawText::default();
    let mut formulas: BTreeMap<String, String> = BTreeMap::new();
    for (index, (term, value)) in terms.into_iter().enumerate() {
        let (coefficient, shape) = (format!("c{}", index + 1), format!("n{}", index + 1));
        law.constants.insert(coefficient.clone(), format!("{value:e} {}", term.unit()));
        match term.factor {
            Factor::Power(_, power) => {
                drop(law.constants.insert(shape.clone(), format!("{power}")))
            }
            Factor::Decay(length) => {
                drop(law.constants.insert(shape.clone(), format!("{length} m")));
            }
            _ => {}
        }
        for part in &term.parts {
            let text = term.formula(part, [&coefficient, &shape]);
            let formula = formulas.entry(part.0.name().to_owned()).or_default();
            match (formula.is_empty(), text.strip_prefix('-')) {
                (true, _) => *formula += &text,
                (false, Some(text)) => *formula += &format!(" - {text}"),
                (false, None) => *formula += &format!(" + {text}"),
            }
        }
    }
    law.formulas = formulas;
    (!law.formulas.is_empty()).then_some(law)
}
