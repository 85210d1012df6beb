//! The colors of the BEV map.

use crate::environment::choice::choice;
use planagent_world::ObjectKind;

/// A color: red, green, blue.
pub type Rgb = [u8; 3];

/// Where no element is drawn.
pub const BACKGROUND: Rgb = [255, 255, 255];
/// The speed arrow of a moving agent: the paper's red, which no element shares.
pub(crate) const ARROW: Rgb = [230, 0, 0];

choice! {
    /// The eight elements of the paper's BEV map.
    pub enum BevElement {
        /// Centerlines of lanes and connectors.
        Centerlines = "centerlines",
        Crosswalks = "crosswalks",
        /// Areas of lanes and connectors.
        Lanes = "lanes",
        Ego = "ego",
        Vehicles = "vehicles",
        Bicycles = "bicycles",
        Pedestrians = "pedestrians",
        /// Cones, barriers, signs and other static objects.
        StaticObstacles = "static_obstacles",
    }
}

/// The color of every element, by a name that a prompt may use.
pub struct Palette;

impl Palette {
    /// Element, color name and color, in the order of [`BevElement::ALL`].
    pub const COLORS: [(BevElement, &'static str, Rgb); 8] = [
        (BevElement::Centerlines, "dark grey", [96, 102, 112]),
        (BevElement::Crosswalks, "yellow", [255, 205, 40]),
        (BevElement::Lanes, "light grey", [205, 209, 216]),
        (BevElement::Ego, "green", [0, 150, 60]),
        (BevElement::Vehicles, "blue", [45, 95, 225]),
        (BevElement::Bicycles, "cyan", [0, 190, 205]),
        (BevElement::Pedestrians, "magenta", [210, 0, 200]),
        (BevElement::StaticObstacles, "black", [20, 20, 20]),
    ];

    pub const fn color(element: BevElement) -> Rgb {
        Self::COLORS[element as usize].2
    }

    /// The elements and their colors in one sentence, for prompts.
    pub fn legend() -> String {
        let parts = Self::COLORS
            .iter()
            .map(|(element, color, _)| format!("{} {color}", element.as_str().replace('_', " ")));
        format!("Colours: {}.", parts.collect::<Vec<_>>().join(", "))
    }
}

impl BevElement {
    pub(crate) fn from_object_kind(kind: ObjectKind) -> Self {
        match kind {
            ObjectKind::Vehicle => Self::Vehicles,
            ObjectKind::Bicycle => Self::Bicycles,
            ObjectKind::Pedestrian => Self::Pedestrians,
            ObjectKind::TrafficCone
            | ObjectKind::Barrier
            | ObjectKind::CzoneSign
            | ObjectKind::GenericObject => Self::StaticObstacles,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_stands_in_the_order_of_the_elements() {
        for (place, (element, _, _)) in Palette::COLORS.iter().enumerate() {
            assert_eq!(*element as usize, place);
        }
    }

    #[test]
    fn colours_can_be_told_apart() {
        let mut all: Vec<Rgb> = Palette::COLORS.iter().map(|entry| entry.2).collect();
        all.extend([BACKGROUND, ARROW]);
        for (i, a) in all.iter().enumerate() {
            for b in &all[i + 1..] {
                let apart: i32 = (0..3)
                    .map(|c| (i32::from(a[c]) - i32::from(b[c])).abs())
                    .sum();
                assert!(apart > 100, "{a:?} and {b:?} are only {apart} apart");
            }
        }
    }
}
