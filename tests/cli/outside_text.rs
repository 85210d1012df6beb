//! Text, files and paths that others chose: nothing of them reaches the terminal unseen, waits
//! forever or is written over.

use super::{SCENE, refused, run};
use crate::agent::scenario;
use crate::endpoint::server::{Server, stream};
use crate::womd::written;
use planagent_scenario::Scenario;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// A scene of which a run takes a moment.
const QUICK: [&str; 5] = [
    "simulate",
    "--scenario",
    "generated/changing_lane/3",
    "--planner",
    "log-replay",
];

fn quick_run(out: &Path) {
    let (code, _, stderr) =
        run(&[&QUICK[..], &["--quiet", "--out", out.to_str().unwrap()]].concat());
    assert_eq!(code, 0, "{stderr}");
}

/// Whether a terminal would obey something in a text.
fn is_obeyed(text: &str) -> bool {
    text.chars().any(|c| {
        c.is_control() && !matches!(c, '\n' | '\t')
            || matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
    })
}

/// What a terminal, a browser or Markdown would obey.
const HOSTILE: &str = "ok\u{1b}]0;owned\u{7}\u{1b}[2J\u{9b}1m\u{1b}[1m\u{202e}\u{2066}\u{61c}<img src=x>|[a](http://b)";

#[test]
fn the_pieces_of_an_answer_are_shown() {
    // An escape may be split between two pieces.
    let pieces = [
        "ok\u{1b}",
        "[2J\u{1b}]0;x\u{7}",
        "\u{202e}\u{2067}\r",
        "\u{1b}[1mbold",
    ];
    let server = Server::always(move || stream(&pieces, true));
    let work = TempDir::new().unwrap();
    let description = work.path().join("m.toml");
    let text = format!(
        "name = 'm'\nprompt_set = 'paper'\n[source]\nendpoint = '{}'\nmodel = 'm'\ngrammar = 'none'\nimage_size = 336\n",
        server.url()
    );
    fs::write(&description, text).unwrap();
    for more in [&[][..], &["--json"]] {
        let flags = ["ask", "What is ahead?", "--scenario", SCENE, "--model"];
        let (code, stdout, stderr) =
            run(&[&flags[..], &[description.to_str().unwrap()], more].concat());
        assert_eq!(code, 0, "{stderr}");
        assert!(
            !is_obeyed(&stdout) && !is_obeyed(&stderr),
            "{}",
            stdout.escape_debug()
        );
        assert!(
            stdout.contains("ok\\u001b[2J") && stdout.contains("\\u202e\\u2067"),
            "{stdout}"
        );
    }
}

#[test]
fn an_argument_is_shown_in_each_kind_of_error() {
    let option = format!("--{HOSTILE}");
    let value = format!("seed={HOSTILE}");
    for arguments in [
        &[HOSTILE][..],
        &[option.as_str()],
        &["simulate", &option],
        &["simulate", HOSTILE],
        &["simulate", "--limit", HOSTILE],
        &["simulate", "--shard", HOSTILE],
        &["simulate", "--quantize", HOSTILE],
        &["simulate", "--planner", HOSTILE],
        &["simulate", "--model", HOSTILE],
        &["simulate", "--prompt-set", HOSTILE],
        &["simulate", "--challenge", HOSTILE],
        &["simulate", "--scenario", HOSTILE],
        &["simulate", "--split", HOSTILE],
        &["simulate", "--resume", HOSTILE],
        &["simulate", "--set", HOSTILE],
        &["simulate", "--set", &value],
        &["report", HOSTILE],
        &["render", HOSTILE, "--png", "x.png"],
        &["compare", HOSTILE, HOSTILE],
        &["scenarios", "show", HOSTILE],
        &["study", HOSTILE],
        &["completions", HOSTILE],
        &["models", "show", HOSTILE],
    ] {
        let said = refused(arguments);
        assert!(!is_obeyed(&said), "{arguments:?}: {}", said.escape_debug());
        assert!(
            said.contains("\\u001b") || !said.contains("owned"),
            "{said}"
        );
    }
}

#[test]
fn tables_of_markdown_and_csv_hold_text_and_nothing_else() {
    let work = TempDir::new().unwrap();
    let out = work.path().join("run");
    quick_run(&out);
    // The planner of a stranger's record is any text.
    let folder = crate::runner::simulations(&out).remove(0);
    let record = folder.join("record.toml");
    let text = fs::read_to_string(&record).unwrap();
    let formula = format!("=1+1{HOSTILE}");
    let hostile: String = text
        .lines()
        .map(|line| match line.split_once(" = ") {
            Some(("scenario" | "scenario_type" | "log_name", _)) => {
                let (key, _) = line.split_once(' ').unwrap();
                format!("{key} = {}\n", toml::Value::String(formula.clone()))
            }
            _ => format!("{line}\n"),
        })
        .collect();
    fs::write(&record, hostile).unwrap();
    let out = out.to_str().unwrap();
    for arguments in [
        &["compare", out, out][..],
        &["compare", out, out, "--csv"],
        &["compare", out, out, "--json"],
        &["compare", out, out, "--by-type"],
        &["report", out],
        &["simulate", "--resume", out],
    ] {
        let (_, stdout, stderr) = run(arguments);
        assert!(
            !is_obeyed(&stdout) && !is_obeyed(&stderr),
            "{arguments:?}: {}",
            stdout.escape_debug()
        );
        if arguments.contains(&"--csv") {
            assert!(
                stdout.contains("'=1+1") && !stdout.contains(",=1"),
                "{stdout}"
            );
        }
    }
}

#[test]
fn control_characters_of_a_recording_are_shown() {
    let work = TempDir::new().unwrap();
    let recording = work.path().join("recording.tfrecord");
    let scene = Scenario {
        id: HOSTILE.to_owned(),
        ..scenario(SCENE)
    };
    fs::write(&recording, written::bytes(&scene)).unwrap();
    let recording = recording.to_str().unwrap();
    let out = work.path().join("run");
    let pictures = work.path().join("pictures");
    let (out, pictures) = (out.to_str().unwrap(), pictures.to_str().unwrap());
    let commands: [&[&str]; 7] = [
        &["scenarios", "list", recording],
        &["scenarios", "list", recording, "--json"],
        &["scenarios", "list", recording, "--csv"],
        &["scenarios", "show", recording],
        &[
            "simulate",
            "--scenario",
            recording,
            "--planner",
            "log-replay,idm",
            "--out",
            out,
        ],
        &["simulate", "--resume", out, "--csv"],
        &["render", out, "--png", pictures, "--planner", "idm"],
    ];
    let mut escapes = 0;
    for command in commands {
        let (code, stdout, stderr) = run(command);
        assert_eq!(code, 0, "{command:?}: {stderr}");
        assert!(
            !is_obeyed(&stdout) && !is_obeyed(&stderr),
            "{command:?}:\n{}{}",
            stdout.escape_debug(),
            stderr.escape_debug()
        );
        escapes += (stdout + &stderr).matches("\\u001b").count();
    }
    assert!(
        escapes >= 5,
        "the escapes of the recording are shown {escapes} times"
    );
    let unknown = refused(&["render", out, "\u{1b}[2J", "--png", "x.png"]);
    assert!(
        !is_obeyed(&unknown) && unknown.contains("\\u001b[2J"),
        "{}",
        unknown.escape_debug()
    );
}

#[test]
fn a_huge_file_of_settings_is_refused_by_its_size_and_a_long_line_is_cut() {
    let work = TempDir::new().unwrap();
    let path = |name: &str| work.path().join(name).to_str().unwrap().to_owned();
    let [config, study, filter] = ["huge.toml", "study.toml", "filter.yaml"].map(path);
    for file in [&config, &study, &filter] {
        // A file with holes, of which nothing is on the disk.
        fs::File::create(file).unwrap().set_len(1 << 40).unwrap();
    }
    for command in [
        &["--config", &config, "simulate"][..],
        &["study", &study],
        &["simulate", "--split", &filter],
    ] {
        let said = refused(command);
        assert!(said.contains("1099511627776 bytes; at most"), "{said}");
    }
    fs::write(&config, format!("seed = \"{}\"\n", "x".repeat(500_000))).unwrap();
    fs::write(&study, format!("name = [\"{}\n", "x".repeat(500_000))).unwrap();
    fs::write(&filter, format!("{}: 3\n", "x".repeat(500_000))).unwrap();
    for command in [
        &["--config", &config, "simulate"][..],
        &["study", &study],
        &["simulate", "--split", &filter],
    ] {
        let said = refused(command);
        assert!(said.len() < 5000, "{} bytes", said.len());
    }
}

#[cfg(unix)]
mod unix {
    use super::{QUICK, SCENE, quick_run, refused, run, written};
    use std::ffi::OsStr;
    use std::fs;
    use std::os::unix::ffi::OsStrExt;
    use std::os::unix::fs::symlink;
    use std::os::unix::net::UnixListener;
    use std::path::Path;
    use std::process::Command;
    use tempfile::TempDir;

    fn pipe(path: &Path) {
        assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
    }

    #[test]
    fn pipes_devices_and_sockets_among_data_are_refused_by_name() {
        let work = TempDir::new().unwrap();
        let path = |name: &str| work.path().join(name);
        for name in ["a.tfrecord", "b.db", "c.yaml", "d.toml"] {
            pipe(&path(name));
        }
        let _socket = UnixListener::bind(path("e.tfrecord")).unwrap();
        let log = path("log");
        fs::create_dir(&log).unwrap();
        pipe(&log.join("scenario_x.parquet"));
        fs::write(log.join("log_map_archive_x.json"), "{}").unwrap();
        let word = |name: &str| path(name).to_str().unwrap().to_owned();
        symlink("/dev/zero", path("f.tfrecord")).unwrap();
        for (name, what) in [
            ("a.tfrecord", "a pipe (FIFO)"),
            ("b.db", "a pipe"),
            ("e.tfrecord", "a socket"),
            ("f.tfrecord", "a device"),
        ] {
            let said = refused(&["scenarios", "list", &word(name)]);
            assert!(said.contains(what) && said.contains(name), "{said}");
        }
        assert!(refused(&["simulate", "--split", &word("c.yaml")]).contains("a pipe"));
        assert!(refused(&["--config", &word("d.toml"), "simulate"]).contains("a pipe"));
        let (code, _, stderr) = run(&["scenarios", "list", &word("log")]);
        assert!(code != 0 && stderr.contains("a pipe"), "{stderr}");
        let folder = work.path().to_str().unwrap();
        let (code, _, stderr) = run(&["scenarios", "list", folder]);
        assert!(
            code != 0 && stderr.contains("a.tfrecord") && stderr.contains("e.tfrecord"),
            "{stderr}"
        );
    }

    #[test]
    fn what_the_user_names_is_written_through_links_and_nothing_else_is() {
        let work = TempDir::new().unwrap();
        let path = |name: &str| work.path().join(name);
        let out = path("run");
        quick_run(&out);
        let (run_folder, link) = (out.to_str().unwrap(), path("link.html"));
        symlink("page.html", &link).unwrap();
        assert_eq!(
            run(&["report", run_folder, "--out", link.to_str().unwrap()]).0,
            0
        );
        assert!(link.is_symlink() && fs::metadata(path("page.html")).unwrap().len() > 1000);
        for (option, name) in [("--gif", "film.gif"), ("--png", "picture.png")] {
            let link = path(&format!("link-{name}"));
            symlink(name, &link).unwrap();
            let (code, _, stderr) = run(&["render", run_folder, option, link.to_str().unwrap()]);
            assert_eq!(code, 0, "{stderr}");
            assert!(link.is_symlink() && fs::metadata(path(name)).unwrap().len() > 100);
        }
        // The folder of a run may come from elsewhere: a link in it is replaced, and what it leads
        // to stays.
        let private = path("private");
        fs::write(&private, "mine").unwrap();
        symlink(&private, out.join("report.html")).unwrap();
        assert_eq!(run(&["report", run_folder]).0, 0);
        assert_eq!(fs::read_to_string(&private).unwrap(), "mine");
        assert!(!out.join("report.html").is_symlink());

        let [fifo, dangling] = [path("fifo.png"), path("folder.gif")];
        pipe(&fifo);
        fs::create_dir(&dangling).unwrap();
        for arguments in [
            vec!["render", run_folder, "--png", fifo.to_str().unwrap()],
            vec!["report", run_folder, "--out", fifo.to_str().unwrap()],
            vec!["report", run_folder, "--out", "/dev/null"],
            vec!["report", run_folder, "--out", dangling.to_str().unwrap()],
            vec![
                "scenarios",
                "show",
                "generated/changing_lane/3",
                "--image",
                fifo.to_str().unwrap(),
            ],
        ] {
            let (code, _, stderr) = run(&arguments);
            assert!(
                code == 2 && stderr.contains("no regular file"),
                "{arguments:?}: {stderr}"
            );
        }
        let fifo = fifo.to_str().unwrap();
        assert!(refused(&[&QUICK[..], &["--out", fifo]].concat()).contains("cannot write"));
    }

    #[test]
    fn the_page_of_a_run_may_be_named_like_its_placeholders() {
        let work = TempDir::new().unwrap();
        let out = work.path().join("{{data}}");
        quick_run(&out);
        assert_eq!(run(&["report", out.to_str().unwrap()]).0, 0);
        let page = fs::read_to_string(out.join("report.html")).unwrap();
        assert!(page.contains("<title>PlanAgent: {{data}}</title>"));
        let [markup, data] = ["</style>", "id=\"index\""].map(|part| page.find(part).unwrap());
        assert!(markup < data, "the data stands in the body");
    }

    #[test]
    fn a_path_that_is_not_utf_8_can_be_used() {
        let work = TempDir::new().unwrap();
        let name = |bytes: &[u8]| work.path().join(OsStr::from_bytes(bytes));
        let (recording, out) = (name(b"r\xff\x80.tfrecord"), name(b"run-\xe6"));
        written::write(&recording, SCENE);
        let program = |arguments: &[&OsStr]| {
            let output = crate::cli::planagent().args(arguments).output().unwrap();
            (
                output.status.code().unwrap(),
                String::from_utf8(output.stderr).unwrap(),
            )
        };
        let os = OsStr::new;
        let start = [
            os("simulate"),
            os("--planner"),
            os("log-replay"),
            os("--scenario"),
            recording.as_os_str(),
        ];
        let (code, stderr) = program(&[&start[..], &[os("--out"), out.as_os_str()]].concat());
        assert_eq!(code, 0, "{stderr}");
        assert!(out.join("summary.json").is_file());
        fs::remove_file(out.join("summary.json")).unwrap();
        fs::remove_dir_all(out.join("simulations")).unwrap();
        let (code, stderr) = program(&[os("simulate"), os("--resume"), out.as_os_str()]);
        assert!(code == 0 && out.join("summary.json").is_file(), "{stderr}");
        let (code, stderr) = program(&[os("report"), out.as_os_str()]);
        assert!(code == 0 && out.join("report.html").is_file(), "{stderr}");
        let (code, stderr) = program(&[os("scenarios"), os("list"), work.path().as_os_str()]);
        assert_eq!(code, 0, "{stderr}");
    }
}
