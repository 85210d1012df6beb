//! Waymo Open Motion: every recording opens, its derived map keeps the rules, and log replay
//! complies.

#![expect(clippy::unwrap_used, reason = "helpers of tests are tests")]

mod rules;
pub(crate) mod written;

use crate::outside::{Missing, Needy, data};
use planagent_scenario::womd::{self, WomdError, WomdFault};
use planagent_scenario::{Frame, Scenario};
use planagent_world::geometry::Point;
use planagent_world::{LaneId, SignalStatus};
use rayon::prelude::*;
use rules::source_ids;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// The files of recordings.
fn files() -> Result<Vec<PathBuf>, Missing> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(data("womd")?)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    files.retain(|file| {
        file.extension()
            .is_some_and(|extension| extension == "tfrecord")
    });
    files.sort();
    Ok(files)
}

/// The recordings of a file.
fn open(file: &Path) -> Result<Vec<Scenario>, WomdError> {
    womd::contents(file)?
        .enumerate()
        .map(|(record, contents)| contents.and_then(|_| womd::open_one(file, record)))
        .collect()
}

/// All recordings, opened once.
pub(crate) fn recordings() -> Result<&'static [Scenario], Missing> {
    static RECORDINGS: OnceLock<Vec<Scenario>> = OnceLock::new();
    let files = files()?;
    Ok(RECORDINGS.get_or_init(|| {
        files
            .par_iter()
            .flat_map_iter(|file| open(file).unwrap())
            .collect()
    }))
}

/// One recording by id.
fn recording(id: &str) -> Result<&'static Scenario, Missing> {
    Ok(recordings()?
        .iter()
        .find(|scenario| scenario.id == id)
        .unwrap())
}

#[test]
fn every_recording_opens_with_its_window() -> Needy {
    for scenario in recordings()? {
        let id = &scenario.id;
        let times: Vec<i64> = scenario
            .frames
            .iter()
            .map(|frame| frame.ego.time_us)
            .collect();
        assert_eq!(times[0], 0, "{id}");
        let (history, driven) = (
            times[scenario.start],
            times[times.len() - 1] - times[scenario.start],
        );
        let expected = if scenario.frames.len() == 91 {
            (1_000_000, 8_000_000)
        } else {
            (2_000_000, 15_000_000)
        };
        assert!(
            (history - expected.0).abs() < 50_000 && (driven - expected.1).abs() < 50_000,
            "{id}: {history} {driven}"
        );
        assert!(
            matches!(scenario.iterations(), 81 | 150 | 151),
            "{id}: {}",
            scenario.iterations()
        );
        assert!(
            scenario
                .frames
                .iter()
                .all(|frame| frame.ego.rear_axle.position().coords.norm() < 1_000.0),
            "{id}"
        );
        assert!(scenario.route.goal.is_some(), "{id}");
    }
    Ok(())
}

#[test]
fn contents_count_what_opening_finds() -> Needy {
    for file in files()? {
        let recordings: Vec<_> = womd::contents(&file).unwrap().map(Result::unwrap).collect();
        let [(id, contents)] = &recordings[..] else {
            panic!("{recordings:?}")
        };
        let scenario = recording(id)?;
        assert_eq!(contents.iterations, scenario.iterations(), "{id}");
        assert!(contents.steps >= scenario.frames.len(), "{id}");
        assert_eq!(contents.lanes, scenario.map.lanes().len(), "{id}");
    }
    Ok(())
}

#[test]
fn maps_of_recordings_keep_the_rules() -> Needy {
    let recordings = recordings()?;
    rules::check(recordings, rules::OF_MAPS);
    let counts = recordings
        .iter()
        .map(|scenario| rules::neighbors_in_one_roadblock(&scenario.map));
    let [listed, shared] = counts.fold([0, 0], |sum, one| [sum[0] + one[0], sum[1] + one[1]]);
    assert!(
        listed == 0 || shared * 4 >= listed * 3,
        "{shared} of {listed}"
    );
    Ok(())
}

#[test]
fn recorded_egos_keep_the_rules() -> Needy {
    rules::check(recordings()?, rules::OF_EGOS);
    Ok(())
}

/// What is known of single recordings: lights, speed limits, and places that the pictures of the
/// maps show to be off the road (a median, a traffic island, the inside of a block).
#[test]
fn what_is_known_of_single_recordings_is_found() -> Needy {
    // The ego of this recording waits at a light that turns green.
    let Scenario {
        map,
        frames,
        start,
        route,
        ..
    } = recording("eb4b91b10ca94ff2")?;
    let ahead: Vec<LaneId> = route
        .lanes(map)
        .into_iter()
        .filter(|&lane| map[lane].has_traffic_lights)
        .collect();
    assert_eq!(source_ids(map, &ahead), vec![184, 185, 259, 260, 261]);
    let shown = |frame: &Frame| frame.lights.status(ahead[1]).unwrap();
    assert_eq!(shown(&frames[*start]), SignalStatus::Red);
    assert_eq!(shown(&frames[frames.len() - 1]), SignalStatus::Green);
    // Of this one the lights were hardly seen.
    let Scenario { frames, .. } = recording("dd0c8c27fdd6ef59")?;
    let all: Vec<SignalStatus> = frames
        .iter()
        .flat_map(|frame| frame.lights.iter())
        .map(|(_, s)| s)
        .collect();
    let unknown = all
        .iter()
        .filter(|&&status| status == SignalStatus::Unknown)
        .count();
    assert!(unknown * 100 > all.len() * 95, "{unknown} of {}", all.len());
    for Scenario { id, map, .. } in recordings()? {
        let known = map.lanes().iter().any(|lane| lane.speed_limit.is_some());
        let unlimited = ["8d3d061e518531d0", "1446dc44bd6fd420", "2831b6fde0420b0d"];
        assert_eq!(known, !unlimited.contains(&id.as_str()), "{id}");
    }
    for (id, places) in [
        (
            "eb4b91b10ca94ff2",
            [(10.6, -22.9), (-36.4, -26.9), (35.2, -11.0)],
        ),
        (
            "8d3d061e518531d0",
            [(97.0, 76.1), (-13.2, 31.2), (27.6, 37.3)],
        ),
    ] {
        let scenario = recording(id)?;
        for (x, y) in places {
            assert!(
                !scenario.map.is_drivable(Point::new(x, y)),
                "{id} ({x}, {y})"
            );
        }
    }
    Ok(())
}

#[test]
fn broken_files_are_reported_with_file_record_and_offset() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("whole.tfrecord");
    written::write(&file, "generated/changing_lane/3");
    let whole = std::fs::read(&file).unwrap();
    let path = folder.path().join("broken.tfrecord");
    let message_for = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        open(&path).unwrap_err().to_string()
    };
    let place = format!("{}: record 0 at byte 0: ", path.display());
    for cut in [1, 7, 11, 12, 500, whole.len() - 4, whole.len() - 1] {
        let message = message_for(&whole[..cut]);
        assert!(
            message.starts_with(&place) && message.contains("ends inside"),
            "cut at {cut}: {message}"
        );
    }
    for flipped in [0, 9, 12, whole.len() / 2, whole.len() - 1] {
        let mut bytes = whole.clone();
        bytes[flipped] ^= 0x10;
        let message = message_for(&bytes);
        assert!(
            message.starts_with(&place) && message.contains("checksum"),
            "byte {flipped}: {message}"
        );
    }
    let second = [whole.clone(), whole[..100].to_vec()].concat();
    assert!(message_for(&second).contains(&format!("record 1 at byte {}", whole.len())));
    assert!(message_for(&[]).contains("the file is empty"));
    let wanted = womd::open_one(&file, 3).unwrap_err();
    assert!(
        matches!(
            wanted.fault,
            WomdFault::NotFound {
                wanted: 3,
                records: 1
            }
        ),
        "{wanted}"
    );
}
