use super::traffic::ARROW_SECONDS;
use super::*;
use crate::environment::sketch::{self, Drawn};
use planagent_world::{ObjectKind, SignalStatus};
use std::path::{Path, PathBuf};

/// Channels of a golden pixel may differ by this much: trigonometry differs in the last bit between
/// C libraries, and a covered pixel share may round the other way.
const GOLDEN_TOLERANCE: u8 = 3;

pub(super) fn busy_road() -> Drawn {
    sketch::straight(3, 2, 1, 9.0)
        .put(ObjectKind::Vehicle, 18.0, 0.0, 0.0, 5.0)
        .put(ObjectKind::Vehicle, -9.0, 3.5, 0.0, 12.0)
        .put(ObjectKind::Vehicle, 8.0, 7.0, std::f64::consts::PI, 10.0)
        .put(ObjectKind::Bicycle, 12.0, -4.4, 0.0, 4.0)
        .put(ObjectKind::Pedestrian, 24.0, -6.5, 1.57, 1.4)
        .put(ObjectKind::TrafficCone, 20.0, -3.5, 0.0, 0.0)
        .put(ObjectKind::Barrier, 23.0, -3.5, 1.57, 0.0)
}

fn crossing() -> Drawn {
    let (drawn, _) = sketch::crossing(2, 0, 8.0, 6.0);
    drawn
        .all_lights(SignalStatus::Red)
        .put(ObjectKind::Vehicle, 26.0, -6.0, 1.57, 8.0)
        .put(ObjectKind::Vehicle, 40.0, 3.5, std::f64::consts::PI, 6.0)
        .put(ObjectKind::Pedestrian, 10.0, 1.0, -1.57, 1.3)
}

fn golden(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../tests/golden/bev")
        .join(name)
}

/// Compares with the golden file, or writes it when `PLANAGENT_UPDATE_GOLDEN` is set.
fn assert_golden(name: &str, image: &RgbImage) {
    let path = golden(name);
    if std::env::var_os("PLANAGENT_UPDATE_GOLDEN").is_some() {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        image.save(&path).unwrap();
    }
    let expected = image::open(&path)
        .unwrap_or_else(|e| panic!("{}: {e}", path.display()))
        .to_rgb8();
    assert_eq!(expected.dimensions(), image.dimensions());
    for (at, (got, want)) in image
        .enumerate_pixels()
        .map(|(x, y, p)| ((x, y), p))
        .zip(expected.pixels())
        .map(|((at, p), w)| (at, (p, w)))
    {
        let off = (0..3).map(|c| got.0[c].abs_diff(want.0[c])).max().unwrap();
        assert!(
            off <= GOLDEN_TOLERANCE,
            "{name} pixel {at:?}: {:?} instead of {:?}",
            got.0,
            want.0
        );
    }
}

fn pixels_of(image: &RgbImage, color: Rgb) -> usize {
    image.pixels().filter(|p| p.0 == color).count()
}

#[test]
fn golden_images() {
    let small = BevView::default();
    let large = BevView::new(336, 64.0).unwrap();
    let round = sketch::roundabout(16.0, 12.0, 5.0).put(ObjectKind::Vehicle, 24.0, -12.0, 0.6, 6.0);
    for (name, drawn) in [
        ("road", busy_road()),
        ("crossing", crossing()),
        ("roundabout", round),
    ] {
        assert_golden(&format!("{name}_128.png"), &render(&drawn.scene(), &small));
        assert_golden(&format!("{name}_336.png"), &render(&drawn.scene(), &large));
    }
    let curve = sketch::curve(-30.0, 10.0, 7.0);
    assert_golden("curve_128.png", &render(&curve.scene(), &small));
}

#[test]
fn the_same_scene_gives_the_same_bytes_in_any_order_of_objects() {
    let mut drawn = busy_road();
    let first = render(&drawn.scene(), &BevView::default());
    drawn.objects.reverse();
    assert_eq!(
        first.as_raw(),
        render(&drawn.scene(), &BevView::default()).as_raw()
    );
}

#[test]
fn every_element_shows_in_its_colour() {
    let image = render(
        &busy_road()
            .put(ObjectKind::Pedestrian, 26.0, 14.0, 0.0, 0.0)
            .scene(),
        &BevView::default(),
    );
    for (element, _, color) in Palette::COLORS {
        if element != BevElement::Crosswalks {
            assert!(
                pixels_of(&image, color) >= 4,
                "{element}: {}",
                pixels_of(&image, color)
            );
        }
    }
    assert!(
        pixels_of(
            &render(&crossing().scene(), &BevView::default()),
            Palette::color(BevElement::Crosswalks)
        ) > 100
    );
}

#[test]
fn up_is_ahead_and_left_is_left() {
    let view = BevView::default();
    let drawn = sketch::straight(1, 0, 0, 0.0).put(ObjectKind::Vehicle, 20.0, 10.0, 0.0, 0.0);
    let image = render(&drawn.scene(), &view);
    let (x, y) = view.to_pixel(drawn.ego.center(), drawn.objects[0].shape.center.position());
    assert!((x - 44.0).abs() < 1e-9 && (y - 24.0).abs() < 1e-9);
    assert_eq!(
        image.get_pixel(44, 24).0,
        Palette::color(BevElement::Vehicles)
    );
    assert_eq!(image.get_pixel(64, 64).0, Palette::color(BevElement::Ego));
    assert_eq!(image.get_pixel(2, 64).0, BACKGROUND);
}

#[test]
fn arrows_are_as_long_as_the_speed() {
    let view = BevView::new(640, 64.0).unwrap();
    let reach = |speed: f64| {
        let drawn = sketch::straight(1, 0, 0, 0.0).put(ObjectKind::Vehicle, 5.0, 10.0, 0.0, speed);
        let image = render(&drawn.scene(), &view);
        // Rows of the column through the vehicle that are mostly red.
        (0..640)
            .filter(|&y| {
                let p = image.get_pixel(220, y).0;
                p[0] > 150 && p[1] < 60 && p[2] < 100
            })
            .count()
    };
    assert_eq!(reach(0.0), 0);
    assert_eq!(reach(0.4), 0);
    for speed in [2.0, 5.0, 10.0, 20.0] {
        let expected = ARROW_SECONDS * speed * view.scale();
        assert!(
            (reach(speed) as f64 - expected).abs() <= 4.0,
            "{speed} m/s: {} px, not {expected}",
            reach(speed)
        );
    }
}

#[test]
fn small_things_stay_visible() {
    let drawn = sketch::straight(1, 0, 0, 0.0)
        .put(ObjectKind::Pedestrian, 15.3, 8.1, 0.0, 0.0)
        .put(ObjectKind::TrafficCone, 20.2, -9.3, 0.3, 0.0);
    let image = render(&drawn.scene(), &BevView::default());
    assert!(pixels_of(&image, Palette::color(BevElement::Pedestrians)) >= 4);
    assert!(pixels_of(&image, Palette::color(BevElement::StaticObstacles)) >= 2);
}

#[test]
fn views_are_checked() {
    assert_eq!(BevView::new(8, 64.0), Err(BevError::Pixels(8)));
    assert!(matches!(
        BevView::new(128, f64::NAN),
        Err(BevError::Meters(_))
    ));
    assert!(matches!(BevView::new(128, 0.0), Err(BevError::Meters(_))));
}

#[test]
fn a_map_far_away_leaves_a_plain_image() {
    let mut drawn = sketch::straight(2, 0, 0, 0.0);
    drawn.ego.rear_axle.y = 5000.0;
    let image = render(&drawn.scene(), &BevView::default());
    let ego = pixels_of(&image, BACKGROUND);
    assert!(ego > 128 * 128 - 150);
}
