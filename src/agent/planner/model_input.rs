//! Environment Transformation of a planning call: what the model of PlanAgent sees.

use super::code_source::CodeSource;
use super::settings::PlanAgentSettings;
use super::{BevSource, PlannerError, PlannerName};
use crate::environment::text::{self, Description};
use crate::environment::{BevView, GraphedScene, bev};
use crate::reasoning::{Names, ScenarioPrompt};
use image::RgbImage;
use planagent_world::SceneView;
use std::sync::Arc;

/// What an agent makes its prompts from.
pub(super) struct ModelInput<'a> {
    pub(super) planner: PlannerName,
    pub(super) source: &'a CodeSource,
    pub(super) settings: &'a PlanAgentSettings,
    pub(super) shuffled_bev: Option<&'a BevSource>,
}

impl ModelInput<'_> {
    /// The BEV image and the lane-graph text of a scene, as far as the settings show them to the
    /// model.
    pub(super) fn scenario_prompt(
        &self,
        seen: GraphedScene<'_>,
    ) -> Result<ScenarioPrompt, PlannerError> {
        let GraphedScene { scene, graph } = seen;
        let environment = &self.settings.environment;
        let form = self
            .source
            .prompts()
            .map(|prompts| prompts.forms().scene_text)
            .filter(|_| environment.lane_graph);
        let description = form.map(|_| Description::from_graph(graph));
        let takes = self.source.image_size();
        let pixels = takes.filter(|_| environment.bev);
        Ok(ScenarioPrompt {
            image: pixels
                .map(|pixels| self.bev(scene, pixels))
                .transpose()?
                .map(Arc::new),
            text: form
                .zip(description.as_ref())
                .map(|(form, description)| text::write(description, form)),
            description,
            names: Names::from_graph(graph),
            // A model that reads text alone gets no words about a picture.
            legend: takes.map_or_else(String::new, |_| bev::Palette::legend()),
        })
    }

    fn bev(&self, scene: &SceneView<'_>, pixels: u32) -> Result<RgbImage, PlannerError> {
        let view = BevView::new(pixels, self.settings.environment.view_m).map_err(|error| {
            PlannerError::Failed {
                doing: "rendering the BEV image",
                source: Box::new(error),
            }
        })?;
        if !self.settings.environment.shuffled_bev {
            return Ok(bev::render(scene, &view));
        }
        let missing = PlannerError::MissingPart {
            planner: self.planner,
            part: "a source of shuffled BEV images",
        };
        let shuffled = self.shuffled_bev.ok_or(missing)?;
        shuffled(self.settings.seed ^ scene.ego.time_us as u64, &view).map_err(|source| {
            PlannerError::Failed {
                doing: "rendering a shuffled BEV image",
                source,
            }
        })
    }
}
