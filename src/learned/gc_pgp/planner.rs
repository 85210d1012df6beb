//! GC-PGP as a planner (`tuplan_garage` `pgp_model.py`, nuplan-devkit `ml_planner.py`).

use super::clusters::{Clusters, ranks, scores};
use super::features::GcPgpFeatures;
use super::network::{GcPgp, GcPgpInputs, LATENT, POSES};
use super::traversals::{TraversalSampler, normal};
use super::waypoints::poses;
use crate::blocks::Probe;
use crate::slot::{Slot, learned_entry};
use crate::{network_failed, prediction};
use candle_core::{Device, Result, Tensor};
use planagent_agent::planner::{Planner, PlannerError, PlannerInitialization, PlannerInput};
use planagent_agent::planner_registry::PlannerEntry;
use planagent_world::Trajectory;
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use std::sync::Arc;

/// Traversals and latent samples of a plan.
const SAMPLES: usize = 1000;
/// Number of clusters of trajectories, and which poses form them: one in this many.
const CLUSTERS: usize = 10;
const STRIDE: usize = 3;
/// As upstream, all draws begin with the same seed in each plan.
const SEED: u64 = 0;
const NAME: &str = "gc-pgp";

/// The planner `gc-pgp`.
pub(crate) fn entry() -> PlannerEntry {
    let slot = Slot::new("GC-PGP", GcPgp::take);
    learned_entry(NAME, "GC-PGP, a learned planner", slot, |network| {
        Box::new(GcPgpPlanner { network })
    })
}

/// GC-PGP: it plans again at every iteration.
#[derive(Debug)]
struct GcPgpPlanner {
    network: Arc<GcPgp>,
}

impl Planner for GcPgpPlanner {
    fn name(&self) -> &'static str {
        NAME
    }

    fn initialize(
        &mut self,
        _: &PlannerInitialization<'_>,
    ) -> std::result::Result<(), PlannerError> {
        Ok(())
    }

    fn compute_trajectory(
        &mut self,
        input: &PlannerInput<'_>,
    ) -> std::result::Result<Trajectory, PlannerError> {
        let features =
            GcPgpFeatures::from_scene(&input.scene).map_err(|source| PlannerError::Failed {
                doing: "filtering the history",
                source: Box::new(source),
            })?;
        let plans = features
            .inputs()
            .and_then(|inputs| self.network.plans(&features, &inputs))
            .map_err(network_failed)?;
        let best = plans
            .first()
            .map(|(_, places)| places.as_slice())
            .expect("walks give one trajectory at least");
        prediction::trajectory(
            &poses(best, features.start_speed()),
            prediction::HALF_SECOND_US,
            &input.scene,
        )
    }
}

/// Places of a trajectory, half a second apart.
type Places = Vec<[f32; 2]>;

impl GcPgp {
    /// The clustered trajectories of a scene with their scores, best first.
    ///
    /// # Errors
    /// When an input has another shape.
    pub fn plans(
        &self,
        features: &GcPgpFeatures,
        inputs: &GcPgpInputs,
    ) -> Result<Vec<(f64, Places)>> {
        // One generator for traversals, latents and clusters, in this order: the same scene gives the
        // same plan.
        let mut random = Pcg64Mcg::seed_from_u64(SEED);
        let scene = self.encode(inputs, true, &Probe::off())?;
        let (policy, targets) = (
            scene.policy.squeeze(0)?.to_vec2::<f32>()?,
            inputs.successors.squeeze(0)?.to_vec2()?,
        );
        let nodes = &features.graph.nodes;
        let on_route = features
            .graph
            .initial
            .iter()
            .copied()
            .filter(|&node| nodes[node].on_route);
        let mut initial: Vec<usize> = on_route.collect();
        if initial.is_empty() {
            initial.clone_from(&features.graph.initial);
        }
        let sampler = TraversalSampler {
            policy: &policy,
            targets: &targets,
            initial: &initial,
        };
        let traversals = sampler.draw(SAMPLES, &mut random);
        let context = self.aggregate(&scene.encodings, &[traversals])?;
        let latent = Tensor::from_vec(
            normal(SAMPLES * LATENT, &mut random),
            (1, SAMPLES, LATENT),
            &Device::Cpu,
        )?;
        let drawn = self
            .decode(&context, &latent)?
            .squeeze(0)?
            .flatten_from(1)?
            .to_vec2::<f32>()?;
        let row = |values: &Vec<f32>| -> Vec<f64> {
            (0..POSES)
                .step_by(STRIDE)
                .flat_map(|pose| [values[2 * pose], values[2 * pose + 1]])
                .map(f64::from)
                .collect()
        };
        let rows: Vec<Vec<f64>> = drawn.iter().map(row).collect();
        let clusters = Clusters::from_rows(&rows, CLUSTERS, &mut random);
        Ok(clustered(&drawn, &clusters))
    }
}

/// The mean trajectories of clusters with their scores, best first.
fn clustered(drawn: &[Vec<f32>], clusters: &Clusters) -> Vec<(f64, Places)> {
    let counts = clusters.counts();
    // Fewer different trajectories than clusters leave some empty.
    let used: Vec<usize> = (0..counts.len())
        .filter(|&cluster| counts[cluster] > 0)
        .collect();
    let sizes: Vec<usize> = used.iter().map(|&cluster| counts[cluster]).collect();
    let centers: Vec<Vec<f64>> = used
        .iter()
        .map(|&cluster| clusters.centers[cluster].clone())
        .collect();
    let mean = |cluster: usize| -> Places {
        let mut sum = [0f32; 2 * POSES];
        for (values, _) in drawn
            .iter()
            .zip(&clusters.labels)
            .filter(|(_, label)| **label == cluster)
        {
            sum.iter_mut()
                .zip(values)
                .for_each(|(sum, value)| *sum += value);
        }
        let count = counts[cluster] as f32;
        sum.as_chunks()
            .0
            .iter()
            .map(|&[x, y]| [x / count, y / count])
            .collect()
    };
    let scores = scores(&ranks(&sizes, &centers));
    let mut plans: Vec<(f64, Places)> = scores
        .into_iter()
        .zip(used.iter().map(|&cluster| mean(cluster)))
        .collect();
    plans.sort_by(|a, b| b.0.total_cmp(&a.0));
    plans
}
