//! `pwrfgs view` and the interactive part of a report: in a browser if one is installed, and with hostile requests.

use crate::common::browser::Browser;
use crate::common::{SMALL, copy_small_run, pwrfgs, refuse, small_run, stderr, succeed, write};
use crate::links::{free_space, hall};
use crate::locate::hall_with_validation;
use crate::model_format::models;
use pwrfgs::model::{Ensemble, compress, file};
use pwrfgs_core::testing::skipped;
use serde_json::{Value, json};
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::{Shutdown, TcpStream};
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

const NO_BROWSER: &str = "no Chromium found; the pages were not loaded";

/// A page that is served until this value is gone.
pub(crate) struct Served {
    child: Child,
    address: String,
}

impl Served {
    pub(crate) fn start(folder: &Path, arguments: &[&str]) -> Self {
        let mut command = pwrfgs(folder);
        command.arg("view").args(arguments).stdout(Stdio::piped()).stderr(Stdio::null());
        let mut child = command.spawn().unwrap();
        let mut address = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut address).unwrap();
        assert!(address.starts_with("http://127.0.0.1:"), "{address}");
        Self { child, address: address.trim().to_owned() }
    }

    /// `127.0.0.1:port`, and the word.
    pub(crate) fn parts(&self) -> (&str, &str) {
        let rest = self.address.strip_prefix("http://").unwrap();
        let (host, token) = rest.split_once('/').unwrap();
        (host, token.trim_end_matches('/'))
    }

    /// Sends bytes and gives the first line of the answer; empty where the connection was closed. `ends`: nothing more comes.
    fn says(&self, request: &[u8], ends: bool) -> String {
        self.answer(request, ends).lines().next().unwrap_or_default().to_owned()
    }

    /// The whole answer.
    fn answer(&self, request: &[u8], ends: bool) -> String {
        String::from_utf8_lossy(&self.bytes(request, ends)).into_owned()
    }

    fn bytes(&self, request: &[u8], ends: bool) -> Vec<u8> {
        let mut stream = TcpStream::connect(self.parts().0).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        _ = stream.write_all(request);
        if ends {
            _ = stream.shutdown(Shutdown::Write);
        }
        let mut answer = Vec::new();
        _ = stream.read_to_end(&mut answer);
        answer
    }

    /// The note of an answer in arrays, and the values of the array `name`; none if there is no such array.
    fn arrays(&self, path: &str, name: &str) -> (Value, Vec<f32>) {
        let (host, token) = self.parts();
        let request = format!("GET /{token}/{path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n");
        let answer = self.bytes(request.as_bytes(), false);
        let body = answer.windows(4).position(|four| four == b"\r\n\r\n").unwrap() + 4;
        let data = 8 + u64::from_le_bytes(answer[body..body + 8].try_into().unwrap()) as usize;
        let (header, data) = answer[body..].split_at(data);
        let header: Value = serde_json::from_slice(&header[8..]).unwrap();
        let end = |k: usize| header[name]["data_offsets"][k].as_u64().unwrap_or(0) as usize;
        let values = data[end(0)..end(1)].as_chunks::<4>().0.iter().map(|four| f32::from_le_bytes(*four)).collect();
        (serde_json::from_str(header["__metadata__"]["pwrfgs"].as_str().unwrap()).unwrap(), values)
    }

    fn get(&self, path: &str, headers: &str) -> String {
        self.body(path, headers).lines().next().unwrap_or_default().to_owned()
    }

    /// The head of an answer with what follows it.
    pub(crate) fn body(&self, path: &str, headers: &str) -> String {
        let (host, _) = self.parts();
        let request = format!("GET {path} HTTP/1.1\r\nHost: {host}\r\n{headers}Connection: close\r\n\r\n");
        self.answer(request.as_bytes(), false)
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        _ = self.child.kill();
        _ = self.child.wait();
    }
}

/// Number of the first sample of a run in one of its sets, such as `test`.
fn first_of(run: &Path, set: &str) -> usize {
    let samples = std::fs::read_to_string(run.join("samples.csv")).unwrap();
    let column = samples.lines().next().unwrap().split(',').position(|name| name == "split").unwrap();
    samples.lines().skip(1).position(|line| line.split(',').nth(column) == Some(set)).unwrap()
}

#[test]
fn viewer_excludes_training_samples_of_baseline() {
    let folder = small_run();
    let served = Served::start(folder, &["run", "NearestNeighbours(k: 1)"]);
    let (_, token) = served.parts();
    let samples = std::fs::read_to_string(folder.join("run/samples.csv")).unwrap();
    let call = |side: usize, set: &str, by_position: bool| {
        let link = first_of(&folder.join("run"), set);
        let fields: Vec<&str> = samples.lines().nth(link + 1).unwrap().split(',').collect();
        let place = if by_position { format!("tx={}", fields[1..4].join(",")) } else { format!("link={link}") };
        served.body(&format!("/{token}/predict?side={side}&{place}"), "")
    };
    for by_position in [true, false] {
        for (number, set) in ["train", "validation", "test"].into_iter().enumerate() {
            let [model, baseline] = [0, 1].map(|side| call(side, set, by_position).replace('\\', ""));
            for answer in [&model, &baseline] {
                assert!(answer.contains(&format!("\"part\":{number}")), "{set}: {answer:.400}");
            }
            assert!(!model.contains("\"score\":null"), "{set}: {model:.400}");
            assert_eq!(baseline.contains("\"score\":null"), set != "test", "{set}: {baseline:.400}");
        }
    }
    let far = |side: usize| served.body(&format!("/{token}/predict?side={side}&tx=22,0,1"), "").replace('\\', "");
    let training = file::read(&folder.join("run/model.safetensors")).unwrap().training_positions.unwrap();
    let metres = training.distances(&[[22.0, 0.0, 1.0]])[0];
    let expected = format!("\"training\":{{\"metres\":{},\"limit\":{}}}", metres as f64, training.limit() as f64);
    assert!(metres > training.limit() && far(0).contains(&expected), "{expected}: {:.400}", far(0));
    assert!(!far(1).contains("\"training\""), "a baseline has no model file");
}

#[test]
fn page_opens_on_test_sample_and_synchronises_views() {
    let folder = small_run();
    let run = folder.join("run");
    let served = Served::start(folder, &["run", "NearestNeighbours(k: 1)"]);
    let Some(page) = Browser::open(&served.address, [1300, 900]) else { return skipped(NO_BROWSER) };
    let opens_on_a_test_sample = |stage: &str| {
        page.wait("document.querySelector('[data-ready]')");
        assert_eq!(page.eval(&format!("{stage}.parts[{stage}.link]")), json!(2), "{stage}");
        let message = page.eval("document.querySelector('[data-numbers]').textContent");
        assert!(message.as_str().unwrap().contains("test"), "{stage}: {message}");
    };
    let stage = "document.querySelector('main').stage";
    opens_on_a_test_sample(stage);
    let message = |set: &str| -> Vec<String> {
        page.eval(&format!("{stage}.goTo({})", first_of(&run, set)));
        let shown = format!("document.querySelector('[data-numbers]').textContent.includes('({}')", &set[..4]);
        page.wait(&format!("{shown} && !{stage}.busy"));
        let all = page.eval("[...document.querySelectorAll('[data-numbers]')].map((own) => own.textContent)");
        serde_json::from_value(all).unwrap()
    };
    let [model, baseline] = message("train").try_into().unwrap();
    assert!(model.starts_with("SSIM 0.") && model.contains("(training), 0.00 m away"), "{model}");
    assert!(baseline.starts_with("not scored: the baseline was fitted to sample "), "{baseline}");
    let [_, baseline] = message("test").try_into().unwrap();
    assert!(baseline.starts_with("SSIM ") && baseline.contains("(test), 0.00 m away"), "{baseline}");
    page.eval(&format!("{stage}.goTo({stage}.ordered('id')[3])"));
    page.wait(&format!("{stage}.link === {stage}.ordered('id')[3] && !{stage}.busy"));
    let names = page.eval("[...document.querySelectorAll('[data-name]')].map((own) => own.textContent).join()");
    assert_eq!(names, json!("run,1-NN"));
    let differ = format!("{stage}.sides[0].picture.some((v, k) => v !== {stage}.sides[1].picture[k])");
    assert_eq!(page.eval(&differ), json!(true), "both sides move, each to its own prediction");
    assert_eq!(page.console(), Vec::<String>::new());
    // The same stage in reports, which predict in the page or show samples alone.
    let powers = tempfile::tempdir().unwrap();
    hall(powers.path());
    let stage = "document.querySelector('[data-source=file]').stage";
    for run in [powers.path().join("run"), run] {
        page.go(&format!("file://{}", run.join("report.html").display()));
        opens_on_a_test_sample(stage);
    }
    page.eval(&format!("{stage}.moveTo([22, 0, 1])"));
    page.wait(
        "document.querySelector('.stage-extrapolation [data-numbers]')?.textContent.startsWith('Extrapolation: ')",
    );
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

/// Where the transmitter is in the window.
fn grip(page: &Browser, stage: &str) -> [f64; 2] {
    let at = page.eval(&format!(
        "(() => {{ const room = {stage}.sides[0].room; const box = room.canvas.getBoundingClientRect(); \
         const at = room.project({stage}.tx); return [box.left + at[0], box.top + at[1]]; }})()"
    ));
    numbers(&at).try_into().unwrap()
}

#[test]
fn viewer_updates_on_drag_and_stops_with_its_window() {
    let folder = small_run();
    let mut served = Served::start(folder, &["run"]);
    let Some(page) = Browser::open(&served.address, [1300, 900]) else { return skipped(NO_BROWSER) };
    page.wait("document.querySelector('[data-ready]')");
    let stage = "document.querySelector('main').stage";
    let before = numbers(&page.eval(&format!("{stage}.tx")));
    let [x, y] = grip(&page, stage);
    page.drag([x, y], [x + 60.0, y + 25.0], 12, false);
    page.wait(&format!("{stage}.updates > 1 && !{stage}.busy"));
    let tx = numbers(&page.eval(&format!("{stage}.tx")));
    assert!(tx[0] != before[0] && tx[1] != before[1] && tx[2] == before[2], "{before:?} {tx:?}");
    let shown = numbers(&page.eval(&format!("Array.from({stage}.sides[0].picture)")));
    let model = file::read(&folder.join("run/model.safetensors")).unwrap();
    let predicted = model.predict(pwrfgs_core::Query::at([tx[0], tx[1], tx[2]], 0));
    assert_eq!(shown.len(), predicted.pixels.len());
    for (shown, own) in shown.iter().zip(&predicted.pixels) {
        assert_eq!(*shown as f32, *own as f32, "the page shows what the program predicts");
    }
    let marked = "document.querySelector('.stage-extrapolation') !== null && document.querySelector('[data-numbers]')\
                  .textContent.startsWith('Extrapolation: ')";
    assert_eq!(page.eval(marked), json!(false), "near the training positions");
    page.eval(&format!("{stage}.moveTo([22, 0, 1])"));
    page.wait(&format!("{marked} && {stage}.sides[0].room.layers.get('transmitter').colours[3] < 255"));
    page.eval(&format!("{stage}.moveTo({tx:?})"));
    page.wait(&format!("!({marked}) && !{stage}.busy"));
    // By height, by keys, by sample, and back through the training.
    let [x, y] = grip(&page, stage);
    page.drag([x, y], [x, y - 30.0], 4, true);
    page.wait(&format!("{stage}.tx[2] > {} && !{stage}.busy", tx[2]));
    page.eval("document.querySelector('[data-room]').focus()");
    let at = numbers(&page.eval(&format!("{stage}.tx")));
    page.key("ArrowRight");
    page.wait(&format!("Math.abs({stage}.tx[0] - {}) > 0.09", at[0]));
    page.eval(
        "document.querySelector('[data-order]').value = 'worst'; document.querySelector('[data-step=\"1\"]').click()",
    );
    page.wait(&format!("{stage}.link !== null && !{stage}.busy"));
    page.wait("document.querySelector('[data-numbers]').textContent.includes('0.00 m away')");
    page.eval("{ const own = document.querySelector('[data-snapshot]'); own.value = 0; own.dispatchEvent(new Event('input')); }");
    page.wait("document.querySelector('[data-snapshot-title]').textContent.startsWith('At the start')");
    page.wait(&format!("{stage}.sides[0].gaussians?.has('gaussian_ids')"));
    page.resize([390, 800]);
    assert_eq!(page.eval("document.documentElement.scrollWidth <= 390"), json!(true), "a phone shows it whole");
    let unnamed = "[...document.querySelectorAll('.stage input, .stage select, .stage button')].filter((own) => \
                   !own.labels?.length && !own.getAttribute('aria-label') && !own.textContent.trim()).length";
    assert_eq!(page.eval(unnamed), json!(0), "every control has a name");
    assert!(page.screenshot(false).starts_with(b"\x89PNG"));
    assert_eq!(page.console(), Vec::<String>::new());
    drop(page);
    let begun = Instant::now();
    while served.child.try_wait().unwrap().is_none() {
        assert!(begun.elapsed() < Duration::from_secs(30), "the program ends after the last page closes");
        std::thread::sleep(Duration::from_millis(50));
    }
    assert!(served.child.wait().unwrap().success());
}

#[test]
fn page_predictions_equal_program_predictions() {
    let folder = small_run();
    let served = Served::start(folder, &["run"]);
    let Some(page) = Browser::open(&served.address, [600, 400]) else { return skipped(NO_BROWSER) };
    page.wait("document.querySelector('[data-ready]')");
    let mut seen = 0;
    for model in models() {
        let small = compress::to_bytes(&Ensemble::of(model.clone()), compress::Bits::Eight).unwrap();
        let restored = file::from_bytes(&small).unwrap().into_only().unwrap();
        let files = [(file::to_bytes(&model), model, [1.0, 0.5, 0.2]), (small, restored, [-2.0, 1.5, 0.9])];
        for (bytes, model, tx) in files {
            let text: Vec<String> = bytes.iter().map(u8::to_string).collect();
            let script = format!(
                "(async () => {{ const [t, p] = [await import('./tensors.js'), await import('./predict.js')]; \
                 const file = t.readTensors(Uint8Array.from([{}])); const why = p.Predictor.refuses(file); \
                 return why ?? Array.from(new p.Predictor(file).predict({tx:?}).picture); }})()",
                text.join(",")
            );
            let found = page.eval(&script);
            if found.is_string() {
                continue; // the released network, which no report predicts
            }
            seen += 1;
            let expected = model.predict(pwrfgs_core::Query::at(tx, 0));
            let errors: Vec<f64> =
                numbers(&found).iter().zip(&expected.pixels).map(|(a, b)| (a - f64::from(*b as f32)).abs()).collect();
            let largest = expected.pixels.iter().fold(1.0, |m: f64, v| m.max(f64::from(v.abs() as f32)));
            let many = errors.iter().filter(|error| **error > 1e-4 * largest).count();
            assert!(many * 1000 <= errors.len(), "{many} pixels of {} differ: {:?}", errors.len(), model.stages.method);
        }
    }
    assert_eq!(seen, 18, "nine models of eleven, whole and compressed");
}

/// Drags the transmitter on a page without a server: the prediction is the program's.
fn predicts_when_dragged(page: &Browser, folder: &Path) {
    page.wait("document.querySelector('[data-ready]')");
    let stage = "document.querySelector('[data-source=file]').stage";
    let model = file::read(&folder.join("run/model.safetensors")).unwrap();
    page.eval("document.querySelector('[data-room]').scrollIntoView({ block: 'center' })");
    let [x, y] = grip(page, stage);
    page.drag([x, y], [x + 40.0, y + 10.0], 6, false);
    page.wait(&format!("{stage}.updates > 1 && !{stage}.busy"));
    let tx = numbers(&page.eval(&format!("{stage}.tx")));
    let shown = numbers(&page.eval(&format!("Array.from({stage}.sides[0].picture)")));
    let own = model.predict(pwrfgs_core::Query::at([tx[0], tx[1], tx[2]], 0));
    let beyond = shown.iter().zip(&own.pixels).filter(|(a, b)| (*a - f64::from(**b as f32)).abs() > 1e-4).count();
    assert!(beyond * 1000 <= shown.len(), "{beyond} pixels of {}", shown.len());
}

#[test]
fn report_works_offline_and_without_scripts() {
    let folder = small_run();
    let path = folder.join("run/report.html");
    assert!(std::fs::metadata(&path).unwrap().len() < 8_000_000);
    let files = tempfile::tempdir().unwrap();
    let room = files.path().join("room.html");
    let save = ["view", "run", "--save", room.to_str().unwrap()];
    let message = stderr(&succeed(folder, &save));
    assert!(message.contains("the model predicts in the page"), "{message}");
    refuse(folder, &save, 2, &["room.html", "exists"]);
    refuse(folder, &["view", "run", "Kriging", "--save", "two.html"], 2, &["one run folder"]);
    refuse(
        folder,
        &["view", "run/model.safetensors", "--save", "file.html"],
        2,
        &["model file, expected a run folder"],
    );
    let [room, address] = [&room, &path].map(|path| format!("file://{}", path.display()));
    let Some(page) = Browser::open(&room, [1300, 900]) else { return skipped(NO_BROWSER) };
    predicts_when_dragged(&page, folder);
    assert_eq!(page.eval("document.querySelectorAll('table').length"), json!(0), "only the room");
    page.go(&address);
    predicts_when_dragged(&page, folder);
    let first = "document.querySelector('table.scores tbody tr').textContent";
    let before = page.eval(first);
    page.eval("document.querySelectorAll('table.scores .sort')[1].click()");
    let sorted = page.eval(first);
    page.eval("document.querySelectorAll('table.scores .sort')[1].click()");
    assert!(sorted != page.eval(first) && !before.is_null(), "a column is sorted, and then the other way");
    assert_eq!(page.console(), Vec::<String>::new());
    page.ask("Emulation.setScriptExecutionDisabled", &json!({ "value": true }));
    page.go(&address);
    let seen = |page: &Browser| page.eval("getComputedStyle(document.querySelector('[data-stage]')).display");
    assert_eq!(seen(&page), json!("none"), "without scripts there is no stage");
    page.ask("Emulation.setScriptExecutionDisabled", &json!({ "value": false }));
    page.go(&address);
    page.wait("document.querySelector('[data-ready]')");
    page.ask("Emulation.setEmulatedMedia", &json!({ "media": "print" }));
    assert_eq!(seen(&page), json!("none"), "nor on paper");
}

#[test]
fn saved_pages_of_powers_and_channels_show_predictions() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    hall(here);
    free_space(here);
    let page = std::fs::read_to_string(here.join("run/report.html")).unwrap();
    assert!(page.contains("<h2>Run</h2>") && !page.contains("<h2>Model</h2>"), "no empty table of the whole model");
    succeed(here, &["run", "waves.ron", "--out", "waves-run", "--scale", "0.05", "-q"]);
    let pages =
        [("run", "Received power,Predicted − measured"), ("waves-run", "Magnitude,Modulus of predicted − measured")];
    for (run, titles) in pages {
        let file = here.join(format!("{run}.html"));
        succeed(here, &["view", run, "--save", file.to_str().unwrap()]);
        let address = format!("file://{}", file.display());
        let Some(page) = Browser::open(&address, [1300, 900]) else { return skipped(NO_BROWSER) };
        page.wait("document.querySelector('[data-ready]')");
        let shown = page
            .eval("[...document.querySelectorAll('[data-pictures] figcaption')].map((own) => own.textContent).join()");
        assert_eq!(shown, json!(titles), "{run}");
        let numbers = page.eval("document.querySelector('[data-numbers]').textContent");
        let numbers = numbers.as_str().unwrap();
        assert!(numbers.contains("(test), 0.00 m away · median of the test set"), "{run}: {numbers}");
        assert!(!numbers.contains("latency"), "{run}: {numbers}");
        fits_a_telephone(&page);
        page.resize([1300, 900]);
        let inked = page.eval(
            "(() => { const own = document.querySelector('[data-pictures] canvas');
            const { data } = own.getContext('2d').getImageData(0, 0, own.width, own.height);
            return data.some((v, k) => k % 4 === 3 && v > 0); })()",
        );
        assert_eq!(inked, json!(true), "{run}");
        assert_eq!(page.console(), Vec::<String>::new());
    }
}

/// On a telephone, the room and the first figure are in the first screen, before the controls, and nothing is wider.
fn fits_a_telephone(page: &Browser) {
    page.resize([400, 860]);
    let end =
        |name: &str| page.eval(&format!("document.querySelector('[data-{name}]').getBoundingClientRect().bottom"));
    let [room, figure, controls] = ["room", "pictures] figure:first-of-type canvas[data-map", "controls"].map(end);
    let [room, figure, controls] = [room, figure, controls].map(|v| v.as_f64().unwrap());
    assert!(room < figure && figure <= 860.0 && figure < controls, "{room}, {figure}, {controls}");
    assert_eq!(page.eval("document.documentElement.scrollWidth <= 400"), json!(true));
}

#[test]
fn page_of_a_run_opens_with_its_median_and_no_table_leaves_its_column() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("small.ron"), SMALL);
    let baselines = "baselines=[MeanSpectrum(), NearestNeighbours(k: 1), NearestNeighbours(k: 3), \
                     NearestNeighbours(k: 5), NearestNeighbours(k: 9), Kriging()]";
    let metrics =
        "metrics=[Ssim(), L1(), Psnr(), RateRatio(snr_db: 0.0), RateRatio(snr_db: 10.0), DirectionError(), Latency()]";
    succeed(here, &["run", "small.ron", "--out", "run", "-q", "--set", baselines, "--set", metrics]);
    succeed(here, &["report", "run", "--out", "all", "-q"]);
    let address = |file: &str| format!("file://{}", here.join(file).display());
    let Some(page) = Browser::open(&address("run/report.html"), [1200, 900]) else { return skipped(NO_BROWSER) };
    page.wait("document.querySelector('[data-ready]')");
    let order = "['[data-room]', '[data-pictures] figure', 'table.scores'].map((own) => \
                 document.querySelector(own).getBoundingClientRect().top)";
    assert!(numbers(&page.eval(order)).is_sorted(), "room, prediction and error come before the scores");
    let notes = page.eval("[...document.querySelectorAll('details')].some((own) => own.open)");
    assert_eq!(notes, json!(false), "notes are folded");
    for file in ["run/report.html", "all/report.html"] {
        page.go(&address(file));
        let wide = page.eval(
            "(() => { document.querySelectorAll('details').forEach((own) => (own.open = true));
            const tables = [...document.querySelectorAll('table')];
            const isWide = (own) => own.getBoundingClientRect().width > own.parentElement.clientWidth + 1;
            return tables.length > 3 ? tables.filter(isWide).map((own) => own.textContent.slice(0, 200)) : null; })()",
        );
        assert_eq!(wide, json!([]), "{file}");
    }
}

#[test]
fn page_opens_with_the_room_in_sight() {
    let served = Served::start(small_run(), &["run"]);
    let Some(page) = Browser::open(&served.address, [1300, 700]) else { return skipped(NO_BROWSER) };
    page.wait("document.querySelector('[data-ready]')");
    let bottom = page.eval("document.querySelector('[data-room]').getBoundingClientRect().bottom");
    assert!(bottom.as_f64().unwrap() <= 700.0, "the room ends at {bottom} of 700 pixels");
    // A Gaussian before the room is not drawn; one in its middle is.
    let changes = |share: f64| {
        page.eval(&format!(
            "(() => {{ const {{ room }} = document.querySelector('main').stage.sides[0];
            const picture = (layer) => {{ room.setGaussians(layer); room.draw(); return room.canvas.toDataURL(); }};
            const [{{ eye }}, {{ target, distance }}] = [room.camera(), room.view];
            const means = new Float32Array(eye.map((v, k) => v + {share} * (target[k] - v)));
            const scales = new Float32Array(3).fill(0.2 * distance), quats = new Float32Array([1, 0, 0, 0]);
            const colours = new Uint8Array([255, 0, 0, 255]);
            return picture(null) !== picture({{ means, scales, quats, colours }}); }})()"
        ))
    };
    assert_eq!([changes(0.2), changes(1.0)], [json!(false), json!(true)]);
}

#[test]
fn samples_are_located_as_by_the_command() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    hall_with_validation(here);
    let run = here.join("run");
    succeed(here, &["locate", "run/model.safetensors", "--out", "located", "--pictures", "0"]);
    let served = Served::start(here, &["run"]);
    let link = first_of(&run, "test");
    let (note, density) = served.arrays(&format!("locate?link={link}"), "density");
    let list = std::fs::read_to_string(here.join("located/locations.csv")).unwrap();
    let row: Vec<&str> = list.lines().nth(1).unwrap().split(',').collect();
    let region = &note["region"];
    let flat =
        [&numbers(&note["estimate"])[..], &[note["misfit"].as_f64().unwrap(), region["area_m2"].as_f64().unwrap()]];
    for (own, cell) in flat.concat().iter().zip(&row[1..]) {
        assert!((own - cell.parse::<f64>().unwrap()).abs() < 1e-3, "{note} {row:?}");
    }
    assert!((note["error_m"].as_f64().unwrap() - row[10].parse::<f64>().unwrap()).abs() < 1e-3, "{note} {row:?}");
    assert_eq!(region["holds"], json!(row[11] == "yes"));
    let highest = density.iter().copied().fold(0.0, f32::max);
    assert!(density.iter().all(|v| *v >= 0.0) && highest > 0.5 && highest <= 1.0001, "highest density {highest}");
    assert_eq!(region["parts"].to_string(), row[6]);
    assert_eq!((&note["left_out"], &note["no_region"]), (&json!(false), &Value::Null));
    // A training sample has the fingerprint of its position, which is left out.
    let (own, _) = served.arrays(&format!("locate?link={}", first_of(&run, "train")), "density");
    assert!(own["left_out"] == json!(true) && own["misfit"].as_f64().unwrap() > 0.0, "{own}");
    let (_, token) = served.parts();
    for (query, words) in [
        ("", "query parameter `link`: no such link"),
        ("?link=1000000", "query parameter `link`: no such link"),
        ("?link=x", "query parameter `link`"),
        ("?link=0&side=7", "query parameter `side`: no such side"),
    ] {
        let answer = served.body(&format!("/{token}/locate{query}"), "");
        assert!(answer.contains(" 400 ") && answer.contains(words), "{query}: {answer}");
    }
    drop(served);
    std::fs::rename(run.join("pipeline.ron"), here.join("other.ron")).unwrap();
    let alone = Served::start(here, &["run/model.safetensors"]);
    let answer = alone.body(&format!("/{}/locate?link=0", alone.parts().1), "");
    assert!(answer.contains(" 400 ") && answer.contains("no data next to this model"), "{answer}");
}

#[test]
fn page_locates_the_selected_sample() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    hall(here);
    let without = Served::start(here, &["run", "NearestNeighbours(k: 1)"]);
    let (note, density) = without.arrays("locate?link=0&side=1", "density");
    let why = note["no_region"].as_str().unwrap();
    assert!(
        why.contains("fewer than 9 validation samples") && density.is_empty() && note["region"].is_null(),
        "{note}"
    );
    let Some(page) = Browser::open(&without.address, [1300, 900]) else { return skipped(NO_BROWSER) };
    let stage = "document.querySelector('main').stage";
    let shown = "[...document.querySelectorAll('[data-located]')].map((own) => own.textContent)";
    let starts = |page: &Browser| {
        page.wait("document.querySelector('[data-ready]')");
        page.eval("document.querySelector('[data-locate]').click()");
        page.wait(&format!("{shown}.every((text) => text.startsWith('Located '))"));
    };
    starts(&page);
    assert!(page.eval(shown).to_string().matches("fewer than 9 validation samples").count() == 2);
    assert_eq!(page.console(), Vec::<String>::new());
    let again = tempfile::tempdir().unwrap();
    let here = again.path();
    hall_with_validation(here);
    let served = Served::start(here, &["run"]);
    page.go(&served.address);
    starts(&page);
    let sentence = page.eval(shown).to_string();
    assert!(sentence.contains(" m² in") || sentence.contains(" m², "), "{sentence}");
    let names = format!("[...{stage}.sides[0].room.meshes.keys(), ...{stage}.sides[0].room.layers.keys()].join()");
    let has = |name: &str| page.eval(&names).as_str().unwrap().split(',').any(|own| own == name);
    assert!(has("density") && has("estimate") && !has("map"), "{}", page.eval(&names));
    page.eval("document.querySelector('[data-step=\"1\"]').click()");
    page.wait(&format!("{shown}[0].startsWith('Located ') && {shown}[0] !== {sentence}[0]"));
    let distance = format!("{stage}.sides[0].room.looking.distance");
    let before = page.eval(&distance).as_f64().unwrap();
    page.eval("document.querySelector('[data-closer]').click()");
    assert_ne!(page.eval(&distance).as_f64().unwrap(), before);
    page.resize([390, 800]);
    assert_eq!(page.eval("document.documentElement.scrollWidth <= 390"), json!(true), "a phone shows it whole");
    page.eval(&format!("{stage}.moveTo({stage}.tx.map((v) => v + 0.1))"));
    page.wait(&format!("{shown}[0].startsWith('Select a sample')"));
    assert!(!has("density") && !has("estimate"));
    page.eval("document.querySelector('[data-locate]').click()");
    page.wait(&format!("{names}.includes('map') && document.querySelector('[data-located]').hidden"));
    assert_eq!(page.console(), Vec::<String>::new());
    page.go(&format!("file://{}", here.join("run/report.html").display()));
    page.wait("document.querySelector('[data-ready]')");
    assert_eq!(page.eval("document.querySelector('[data-of-locating]').hidden"), json!(true), "a report has no server");
}

#[test]
fn viewer_follows_active_run() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    write(&folder.join("small.ron"), SMALL.replace("steps: 60", "steps: 100_000"));
    let mut run = pwrfgs(folder).args(["run", "small.ron", "--out", "run", "-q"]).spawn().unwrap();
    crate::common::wait_for_step(&mut run, &folder.join("run"), 30);
    let served = Served::start(folder, &["run"]);
    let page = Browser::open(&served.address, [1000, 700]);
    if let Some(page) = &page {
        page.wait("document.querySelector('[data-ready]')");
        page.wait("/step [\\d,]+ of 100,000, N = \\d+, loss/.test(document.querySelector('[data-name]').textContent)");
        page.wait("document.querySelectorAll('figure').length >= 4");
        assert_eq!(page.console(), Vec::<String>::new());
    }
    run.kill().unwrap();
    run.wait().unwrap();
    if page.is_none() {
        skipped(NO_BROWSER);
    }
}

#[test]
fn refuses_malicious_requests_and_keeps_serving() {
    let folder = small_run();
    let served = Served::start(folder, &["run/model.safetensors"]);
    let (host, token) = served.parts();
    let room = format!("/{token}/room");
    let good = || assert_eq!(served.get(&room, ""), "HTTP/1.1 200 OK");
    good();
    let long = format!("X-Long: {}\r\n", "x".repeat(100_000));
    let many = "X-Many: 1\r\n".repeat(500);
    for (path, headers, status) in [
        ("/", "", "404"),
        ("/room", "", "404"),
        ("/0123456789abcdef0123456789abcdef/room", "", "404"),
        (&room, "Origin: http://evil.example\r\n", "403"),
        (&room, "Origin: null\r\n", "403"),
        (&room, "Sec-Fetch-Site: cross-site\r\n", "403"),
        (&room, "Host: evil.example\r\n", "421"),
        (&room, "Content-Length: 10\r\n", "413"),
        (&room, &long, "431"),
        (&room, &many, "431"),
        (&format!("{room}/../../../etc/passwd"), "", "404"),
        (&format!("/{token}/predict?tx=nan,0,0"), "", "400"),
        (&format!("/{token}/predict?tx=1,2"), "", "400"),
        (&format!("/{token}/predict?tx=1,2,3&receiver=99"), "", "400"),
        (&format!("/{token}/predict?link=99999999999999999999"), "", "400"),
        (&format!("/{token}/link?link=1000000"), "", "400"),
        (&format!("/{token}/gaussians?snapshot=99"), "", "400"),
        (&format!("/{token}/gaussians?side=7"), "", "400"),
    ] {
        let message = served.get(path, headers);
        assert!(message.contains(&format!(" {status} ")), "{path} {}: {message}", &headers[..headers.len().min(60)]);
    }
    let foreign = format!("GET {room} HTTP/1.1\r\nHost: rebound.example\r\nConnection: close\r\n\r\n");
    assert!(served.says(foreign.as_bytes(), false).contains(" 421 "), "a name that leads here is not ours");
    for method in ["POST", "PUT", "DELETE", "OPTIONS"] {
        let request = format!("{method} {room} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n");
        assert!(served.says(request.as_bytes(), false).contains(" 405 "), "{method}");
    }
    for garbage in
        [&b"\0\xff\xfe rubbish \r\n\r\n"[..], b"GET", b"GET / HTTP/9.9\r\n\r\n", b"\r\n\r\n\r\n", &vec![b'A'; 50_000]]
    {
        let message = served.says(garbage, true);
        assert!(!message.contains(" 200 "), "{message}");
    }
    good();
}

/// The head of the next answer of a connection that stays open; its body is read away.
fn next_head(stream: &mut BufReader<TcpStream>) -> String {
    let mut head = String::new();
    while !head.ends_with("\r\n\r\n") {
        assert!(stream.read_line(&mut head).unwrap() > 0, "closed after: {head}");
    }
    let length = head.to_lowercase().split("content-length: ").nth(1).unwrap().lines().next().unwrap().parse().unwrap();
    stream.read_exact(&mut vec![0; length]).unwrap();
    head
}

#[test]
fn idle_connections_do_not_block_page() {
    let folder = small_run();
    let served = Served::start(folder, &["run/model.safetensors"]);
    let (host, token) = served.parts();
    let room = format!("/{token}/room");
    let connect = || {
        let stream = TcpStream::connect(host).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(5))).unwrap(); // a silent connection is closed after ten
        BufReader::new(stream)
    };
    let ask = |stream: &mut BufReader<TcpStream>, path: &str| {
        let request = format!("GET {path} HTTP/1.1\r\nHost: {host}\r\n\r\n");
        stream.get_mut().write_all(request.as_bytes()).unwrap();
        next_head(stream)
    };
    let mut kept = connect();
    assert!(ask(&mut kept, &room).starts_with("HTTP/1.1 200 OK"));
    // The connections stay open and silent: the page is there all the same, and who has the token keeps the place.
    for count in [64, 300] {
        let silent: Vec<TcpStream> = (0..count).map(|_| TcpStream::connect(host).unwrap()).collect();
        assert!(ask(&mut connect(), &room).starts_with("HTTP/1.1 200 OK"), "beside {count} silent connections");
        assert!(ask(&mut kept, &room).starts_with("HTTP/1.1 200 OK"), "beside {count} silent connections");
        drop(silent);
    }
    // Who is refused does not keep the connection.
    let mut refused = connect();
    let head = ask(&mut refused, "/room");
    assert!(head.starts_with("HTTP/1.1 404") && head.to_lowercase().contains("\r\nconnection: close\r\n"), "{head}");
    assert_eq!(refused.read(&mut [0]).unwrap(), 0, "the connection is closed");
}

#[test]
fn models_of_program_are_shown_without_data() {
    let folder = tempfile::tempdir().unwrap();
    // Its folder has a pipeline that is not that of the model.
    write(&folder.path().join("pipeline.ron"), "Pipeline(");
    for arguments in [&["s23"][..], &["s23", "s23"], &["office-channel"], &["ble"]] {
        let served = Served::start(folder.path(), arguments);
        let word = served.parts().1;
        let answer = served.body(&format!("/{word}/room"), "");
        assert!(answer.contains(arguments[0]), "{arguments:?}: {answer}");
    }
}

#[test]
fn reports_models_that_cannot_be_viewed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    copy_small_run(path, "run");
    write(&path.join("broken.safetensors"), "no model");
    std::fs::create_dir(path.join("empty")).unwrap();
    refuse(path, &["view", "nothing"], 2, &["nothing"]);
    refuse(path, &["view", "empty"], 2, &["not a run folder"]);
    refuse(path, &["view", "broken.safetensors"], 2, &["broken.safetensors"]);
    refuse(path, &["view", "run", "NearestNeighbour"], 2, &["NearestNeighbours"]);
    refuse(path, &["view", "run", "LogDistance()"], 2, &["not available for spectra"]);
}

#[test]
#[ignore = "draws docs/images/view.png, walk-start.png, walk-end.png and locate-view.png, of runs/quickstart"]
fn draws_images_of_documentation() {
    let checkout = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let served = Served::start(&checkout, &["runs/quickstart"]);
    let page = Browser::open(&served.address, [1360, 860]).expect("there is a Chromium");
    page.wait("document.querySelector('[data-ready]')");
    page.eval(
        "(() => { const { room } = document.querySelector('main').stage.sides[0]; room.turn(0.9, 0.12); room.zoom(0.78); \
         document.querySelector('main').stage.colourBy('strength'); \
         document.querySelector('[data-colour]').value = 'strength'; })()",
    );
    for (name, at) in [("view", [3.2, 2.4, 1.2]), ("walk-start", [2.4, 3.6, 1.2]), ("walk-end", [4.6, 4.2, 1.2])] {
        page.eval(&format!("document.querySelector('main').stage.moveTo({at:?})"));
        std::thread::sleep(Duration::from_secs(3));
        write(&checkout.join(format!("docs/images/{name}.png")), page.screenshot(false));
    }
    page.resize([940, 500]);
    page.eval(
        "(() => { const { stage } = document.querySelector('main'); stage.seek(230); \
         document.querySelector('[data-locate]').click(); })()",
    );
    page.wait("document.querySelector('[data-located]').textContent.startsWith('Located ')");
    page.eval(
        "document.querySelector('[data-closer]').click(); document.querySelector('[data-sides]').scrollIntoView()",
    );
    std::thread::sleep(Duration::from_secs(3));
    write(&checkout.join("docs/images/locate-view.png"), page.screenshot(false));
}
