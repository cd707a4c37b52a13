//! Quantities, effects and files as text for people.

use std::path::Path;

use vehicle::effects::{EffectSet, Kind};

use super::axis::significant;

/// A length.
pub fn length(metres: f64) -> String {
    match metres {
        m if m < 0.001 => format!("{:.2} mm", m * 1e3),
        m if m < 0.1 => format!("{:.1} mm", m * 1e3),
        m => format!("{m:.3} m"),
    }
}

/// What is nothing or nearly nothing.
pub fn smallness(value: f64) -> String {
    if value == 0.0 { "0".to_owned() } else { format!("{value:.1e}") }
}

/// Four significant digits, without zeros that say nothing.
pub fn short(value: f64) -> String {
    let text = significant(value);
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

/// Effects with their parameters, in the catalogue's order and units.
pub fn effects(effects: &EffectSet) -> String {
    let one = |(id, slots): (vehicle::effects::EffectId, &vehicle::effects::Slots)| {
        let parameters: Vec<String> = id
            .spec()
            .slots()
            .filter(|slot| slot.component == 0)
            .map(|slot| {
                let value = match slot.parameter.kind {
                    Kind::Scalar | Kind::Index => short(slots[slot.index]),
                    Kind::Vec3 => {
                        let axes = &slots[slot.index..slot.index + 3];
                        format!(
                            "[{}]",
                            axes.iter().copied().map(short).collect::<Vec<_>>().join(", ")
                        )
                    }
                };
                format!("{} {value}", slot.parameter.name)
            })
            .collect();
        format!("{id} ({})", parameters.join(", "))
    };
    let law = |law: &vehicle::law::Law| {
        let formulas = law.text().formulas.iter();
        let formulas: Vec<String> = formulas.map(|(at, text)| format!("{at} = {text}")).collect();
        format!("law {} ({})", law.name(), formulas.join("; "))
    };
    let all: Vec<String> = effects.iter().map(one).chain(effects.laws().iter().map(law)).collect();
    if all.is_empty() { "no effects".to_owned() } else { all.join(", ") }
}

/// A file as seen from a page's folder; one that is elsewhere by its name alone, so that a page
/// says nothing of the machine that it was made on.
pub fn beside(path: &Path, folder: &Path) -> String {
    path.strip_prefix(folder).map_or_else(|_| file_name(path), |path| path.display().to_string())
}

/// A file by its name.
pub fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_paths_are_relative_to_the_page() {
        let folder = Path::new("/flights/demo");
        assert_eq!(beside(Path::new("/flights/demo/logs/a.mcap"), folder), "logs/a.mcap");
        assert_eq!(beside(Path::new("/data/b.mcap"), folder), "b.mcap");
    }

    #[test]
    fn effects_are_listed_with_their_numbers() {
        let mut set = EffectSet::new();
        assert_eq!(effects(&set), "no effects");
        set.insert_argument("rotor_drag:d_xy=0.012,d_z=0.008").expect("an effect");
        set.insert_argument("inertia:scale=[1.2,1.1,1]").expect("an effect");
        assert_eq!(
            effects(&set),
            "rotor_drag (d_xy 0.012, d_z 0.008), inertia (scale [1.2, 1.1, 1])"
        );
        assert_eq!((smallness(0.0), smallness(1.23e-9)), ("0".to_owned(), "1.2e-9".to_owned()));
        assert_eq!((length(0.0047), length(0.299)), ("4.7 mm".to_owned(), "0.299 m".to_owned()));
    }
}
