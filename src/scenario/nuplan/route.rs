//! The route of a scenario: a text with ids of roadblocks and roadblock connectors.

use super::database::Database;
use super::error::{NuPlanError, RouteFault, ScenarioFault};
use super::lane_map::NuPlanMap;
use super::logs::LogScenario;
use super::rows::pose_of;
use super::schema::{EGO_POSE, LIDAR_PC, SCENE};
use super::token::Token;
use planagent_world::{RoadblockId, Route};

/// The scene of a scenario's tagged row, its goal, and the ids of its route.
pub(super) fn route_ids(
    database: &Database,
    token: Token,
) -> Result<(Token, Option<Token>, Vec<i64>), NuPlanError> {
    let failed = |fault| NuPlanError::Scenario {
        path: database.path.clone(),
        token,
        fault,
    };
    let scene = database.first(LIDAR_PC, "WHERE token = ?1", [token], |record| {
        record.token("scene_token")
    })?;
    let scene = scene.ok_or_else(|| failed(ScenarioFault::NotInLog))?;
    let found = database.first(SCENE, "WHERE token = ?1", [scene], |record| {
        Ok((
            record.maybe_token("goal_ego_pose_token")?,
            record.maybe_text("roadblock_ids")?,
        ))
    })?;
    let Some((goal, text)) = found else {
        return Err(failed(ScenarioFault::Route {
            scene,
            fault: RouteFault::Empty,
        }));
    };
    let ids =
        ids(text.as_deref()).map_err(|fault| failed(ScenarioFault::Route { scene, fault }))?;
    Ok((scene, goal, ids))
}

pub(super) fn read(
    database: &Database,
    found: &LogScenario,
    map: &NuPlanMap,
) -> Result<Route, NuPlanError> {
    let (scene, goal, ids) = route_ids(database, found.token)?;
    let roadblocks = roadblocks(&ids, map).map_err(|fault| NuPlanError::Scenario {
        path: database.path.clone(),
        token: found.token,
        fault: ScenarioFault::Route { scene, fault },
    })?;
    let goal = match goal {
        Some(pose) => database.first(EGO_POSE, "WHERE token = ?1", [pose], pose_of)?,
        None => None,
    };
    Ok(Route {
        roadblocks,
        goal: goal.map(|goal| map.to_local(goal)),
        goal_lane: None,
    })
}

/// The ids in a text, split at single spaces as in the devkit.
fn ids(text: Option<&str>) -> Result<Vec<i64>, RouteFault> {
    let words: Vec<&str> = text
        .unwrap_or_default()
        .split(' ')
        .filter(|word| !word.is_empty())
        .collect();
    if words.is_empty() {
        return Err(RouteFault::Empty);
    }
    words
        .into_iter()
        .map(|word| word.parse().map_err(|_| RouteFault::Word(word.to_owned())))
        .collect()
}

/// The roadblock, else the roadblock connector, of each id.
fn roadblocks(ids: &[i64], map: &NuPlanMap) -> Result<Vec<RoadblockId>, RouteFault> {
    let unknown = |id: i64| RouteFault::Unknown {
        id,
        map: map.lanes.name().to_owned(),
    };
    ids.iter()
        .map(|&id| map.roadblock(id).ok_or_else(|| unknown(id)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_are_separated_by_spaces() {
        assert_eq!(ids(Some("12 34  5 ")), Ok(vec![12, 34, 5]));
        assert_eq!(ids(Some("")), Err(RouteFault::Empty));
        assert_eq!(ids(None), Err(RouteFault::Empty));
        assert_eq!(
            ids(Some("12,34")),
            Err(RouteFault::Word("12,34".to_owned()))
        );
    }
}
