//! The numbers of the paper that stand in the studies.

use crate::outside::{Missing, Needy, data};
use planagent_lab::study::{Published, PublishedModel, find};

/// The paper's source.
fn paper() -> Result<String, Missing> {
    Ok(std::fs::read_to_string(data("../paper/planagent.tex")?).unwrap())
}

/// The numbers with two decimals in each row of the table with a label; rows without any are left
/// out.
fn rows(paper: &str, label: &str) -> Vec<(String, Vec<f64>)> {
    let end = paper.find(&format!("\\label{{{label}}}")).unwrap();
    let begin = paper[..end].rfind("\\begin{tabular}").unwrap();
    let numbers = |row: &str| -> Vec<f64> {
        let words = row.split(|c: char| !c.is_ascii_digit() && c != '.');
        words
            .filter(|w| w.split_once('.').is_some_and(|(_, cents)| cents.len() == 2))
            .flat_map(str::parse)
            .collect()
    };
    let rows = paper[begin..end]
        .split("\\\\")
        .map(|row| (row.to_owned(), numbers(row)));
    rows.filter(|(_, numbers)| numbers.len() > 1).collect()
}

/// The published rows of a study, by name of the variant.
fn published(study: &str) -> Vec<(String, Published)> {
    let study = find(study).unwrap();
    let rows = study
        .variants
        .iter()
        .map(|variant| (study.name_of(variant), variant.published.clone()));
    rows.filter(|(_, published)| *published != Published::default())
        .collect()
}

#[test]
fn the_main_table_is_the_papers() -> Needy {
    let paper = paper()?;
    let rows = rows(&paper, "tab: main_result");
    let ours = published("main");
    let named = [
        ("Log-replay", "log-replay"),
        ("{IDM", "idm"),
        ("{PDM-Closed", "pdm-closed"),
        ("{PDM-Open", "pdm-open"),
        ("{PlanTF", "plantf"),
        ("{GameFormer", "gameformer"),
        ("{DTPP", "dtpp"),
        ("{GC-PGP", "gc-pgp"),
        ("{UrbanDriver", "urban-driver"),
        ("{RasterModel", "raster-model"),
        ("{UNC}", "llm-assist-unc"),
        ("{PAR}", "llm-assist-par"),
        ("PlanAgent(Ours)", "plan-agent (paper)"),
        ("PlanAgent(Ours)", "plan-agent"),
    ];
    assert_eq!(ours.len(), named.len());
    for (name, variant) in named {
        let row = rows
            .iter()
            .find(|(row, _)| row.contains(name))
            .map(|(_, numbers)| numbers.clone());
        let (_, published) = ours.iter().find(|(own, _)| own == variant).unwrap();
        let scores = [published.val14, published.test14_hard]
            .into_iter()
            .flatten()
            .flatten();
        assert_eq!(row, Some(scores.collect()), "{name}");
    }
    Ok(())
}

#[test]
fn seven_rows_of_the_papers_val14_are_test14_random() {
    let study = find("main").unwrap();
    let same = study.variants.iter().filter(|variant| {
        variant.published.val14.is_some()
            && variant.published.val14 == variant.reported.test14_random
    });
    let names: Vec<&str> = same.map(|variant| variant.planner.as_str()).collect();
    assert_eq!(
        names,
        [
            "log-replay",
            "idm",
            "pdm-open",
            "gameformer",
            "gc-pgp",
            "urban-driver",
            "raster-model"
        ]
    );
}

#[test]
fn the_other_tables_are_the_papers() -> Needy {
    let paper = paper()?;
    for (label, study) in [
        ("tab: ablation_et", "environment"),
        ("tab: ablation_rr", "reasoning"),
        ("tab: interval", "interval"),
        ("tab: llm", "mllm"),
    ] {
        let mut ours = published(study);
        ours.retain(|(name, _)| name != "(pdm-closed)");
        let table = rows(&paper, label);
        let scores = |published: &Published| {
            published
                .test14_hard
                .into_iter()
                .flatten()
                .collect::<Vec<f64>>()
        };
        let mut theirs: Vec<Vec<f64>> = table.iter().map(|(_, numbers)| numbers.clone()).collect();
        let mut own: Vec<Vec<f64>> = ours
            .iter()
            .map(|(_, published)| scores(published))
            .collect();
        for numbers in [&mut theirs, &mut own] {
            numbers.sort_by(|a, b| a[0].total_cmp(&b[0]));
        }
        assert_eq!(theirs, own, "{label}");
        for PublishedModel {
            parameters,
            time_ms,
        } in ours
            .iter()
            .filter_map(|(_, published)| published.model.clone())
        {
            let cells = format!("& {} & {time_ms} ms", parameters.as_deref().unwrap_or("-"));
            assert!(table.iter().any(|(row, _)| row.contains(&cells)), "{cells}");
        }
    }
    Ok(())
}
