//! Headless Chromium, driven over pipes by its protocol for developers: messages of JSON, each with a zero at its end.

use serde_json::{Value, json};
use std::cell::RefCell;
use std::io::{BufRead as _, BufReader, Write as _};
use std::os::unix::process::CommandExt as _;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

/// How long an answer may take.
const PATIENCE: Duration = Duration::from_mins(1);
const NAMES: [&str; 3] = ["chromium", "chromium-browser", "google-chrome"];

/// One browser with one page; it ends with this value.
pub(crate) struct Browser {
    child: Child,
    state: RefCell<State>,
    _profile: tempfile::TempDir,
}

struct State {
    stdin: ChildStdin,
    events: Receiver<Value>,
    last: u64,
    session: Option<String>,
    console: Vec<String>,
}

impl Browser {
    /// Opens `address` in a window of this size; nothing where there is no Chromium.
    pub(crate) fn open(address: &str, size: [u32; 2]) -> Option<Self> {
        let name = NAMES.into_iter().find(|name| Command::new(name).arg("--version").output().is_ok())?;
        let profile = tempfile::tempdir().unwrap();
        // Chromium reads requests from its third file and writes answers to its fourth.
        let mut child = Command::new("sh")
            .args(["-c", r#"exec "$0" "$@" 3<&0 4>&1 0</dev/null 1>/dev/null 2>/dev/null"#, name])
            .args(["--headless", "--no-sandbox", "--remote-debugging-pipe", "--use-angle=swiftshader"])
            .args(["--enable-unsafe-swiftshader", "--hide-scrollbars", "--disable-dev-shm-usage"])
            .args(["--force-device-scale-factor=1", "--no-first-run", "--disable-background-networking"])
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .arg("about:blank")
            .process_group(0)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let (stdin, stdout) = (child.stdin.take().unwrap(), child.stdout.take().unwrap());
        let (sender, events) = channel();
        std::thread::spawn(move || {
            for message in BufReader::new(stdout).split(0).map_while(Result::ok) {
                if sender.send(serde_json::from_slice(&message).unwrap_or(Value::Null)).is_err() {
                    break;
                }
            }
        });
        let state = State { stdin, events, last: 0, session: None, console: Vec::new() };
        let browser = Self { child, state: RefCell::new(state), _profile: profile };
        let target = browser.ask("Target.createTarget", &json!({ "url": "about:blank" }));
        let attach = json!({ "targetId": target["targetId"], "flatten": true });
        let session = browser.ask("Target.attachToTarget", &attach)["sessionId"].as_str().unwrap().to_owned();
        browser.state.borrow_mut().session = Some(session);
        for domain in ["Page", "Runtime", "Log", "Audits"] {
            browser.ask(&format!("{domain}.enable"), &json!({}));
        }
        browser.resize(size);
        browser.go(address);
        Some(browser)
    }

    /// Opens another address in the page.
    pub(crate) fn go(&self, address: &str) {
        let answer = self.ask("Page.navigate", &json!({ "url": address }));
        assert!(answer["errorText"].is_null(), "{address}: {}", answer["errorText"]);
        self.wait("document.readyState === 'complete' && location.href !== 'about:blank'");
    }

    /// Sends a request and waits for its answer.
    pub(crate) fn ask(&self, method: &str, parameters: &Value) -> Value {
        let mut state = self.state.borrow_mut();
        state.last += 1;
        let id = state.last;
        let mut request = json!({ "id": id, "method": method, "params": parameters });
        if let Some(session) = &state.session {
            request["sessionId"] = json!(session);
        }
        state.stdin.write_all(format!("{request}\0").as_bytes()).unwrap();
        loop {
            let message = state.events.recv_timeout(PATIENCE).unwrap_or_else(|e| panic!("{method}: no answer ({e})"));
            if message["id"] == id {
                assert!(message["error"].is_null(), "{method}: {}", message["error"]);
                return message["result"].clone();
            }
            state.note(&message);
        }
    }

    /// The value of an expression; a promise is waited for.
    pub(crate) fn eval(&self, expression: &str) -> Value {
        let call = json!({ "expression": expression, "awaitPromise": true, "returnByValue": true });
        let answer = self.ask("Runtime.evaluate", &call);
        assert!(answer["exceptionDetails"].is_null(), "{expression}: {}", answer["exceptionDetails"]);
        answer["result"]["value"].clone()
    }

    /// Waits until an expression is true.
    pub(crate) fn wait(&self, condition: &str) {
        let begun = Instant::now();
        while self.eval(&format!("Boolean({condition})")) != json!(true) {
            assert!(begun.elapsed() < PATIENCE, "never: {condition}; {:.900?}", self.console().first());
            std::thread::sleep(Duration::from_millis(30));
        }
    }

    /// Warnings, errors and exceptions so far.
    pub(crate) fn console(&self) -> Vec<String> {
        self.ask("Runtime.getIsolateId", &json!({})); // what was said before it has then arrived
        self.state.borrow().console.clone()
    }

    pub(crate) fn resize(&self, [width, height]: [u32; 2]) {
        let mobile = width < 500;
        let size = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": mobile });
        self.ask("Emulation.setDeviceMetricsOverride", &size);
    }

    /// Presses the button at a place, moves in `steps` and lets go; with `shift` held.
    pub(crate) fn drag(&self, from: [f64; 2], to: [f64; 2], steps: u32, shift: bool) {
        let event = |kind: &str, [x, y]: [f64; 2], buttons: u32| {
            let modifiers = if shift { 8 } else { 0 };
            let what = json!({ "type": kind, "x": x, "y": y, "button": "left", "buttons": buttons, "clickCount": 1,
                "modifiers": modifiers });
            self.ask("Input.dispatchMouseEvent", &what);
        };
        event("mouseMoved", from, 0);
        event("mousePressed", from, 1);
        for k in 1..=steps {
            let part = f64::from(k) / f64::from(steps);
            event("mouseMoved", [0, 1].map(|i| from[i] + (to[i] - from[i]) * part), 1);
        }
        event("mouseReleased", to, 0);
    }

    pub(crate) fn key(&self, name: &str) {
        for kind in ["keyDown", "keyUp"] {
            self.ask("Input.dispatchKeyEvent", &json!({ "type": kind, "key": name, "code": name }));
        }
    }

    /// The window, or the whole page, as PNG.
    pub(crate) fn screenshot(&self, whole: bool) -> Vec<u8> {
        let call = json!({ "format": "png", "captureBeyondViewport": whole });
        unbase64(self.ask("Page.captureScreenshot", &call)["data"].as_str().unwrap())
    }
}

impl State {
    fn note(&mut self, message: &Value) {
        let (method, parameters) = (message["method"].as_str().unwrap_or_default(), &message["params"]);
        let loud = |level: &Value| ["warning", "error"].contains(&level.as_str().unwrap_or_default());
        let is_reported = match method {
            "Runtime.exceptionThrown" => true,
            "Runtime.consoleAPICalled" => loud(&parameters["type"]),
            "Log.entryAdded" => loud(&parameters["entry"]["level"]),
            "Audits.issueAdded" => !parameters["issue"]["details"]["contentSecurityPolicyIssueDetails"].is_null(),
            _ => false,
        };
        // Software rendering says that reading a picture back is slow.
        let text = parameters.to_string();
        if is_reported && !text.contains("GPU stall due to ReadPixels") {
            self.console.push(text);
        }
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // All of its processes: none may write into the profile while it is removed.
        _ = Command::new("sh").args(["-c", "kill -s KILL -- -$0", &self.child.id().to_string()]).status();
        _ = self.child.wait();
    }
}

fn unbase64(text: &str) -> Vec<u8> {
    let value = |c: u8| match c {
        b'A'..=b'Z' => c - b'A',
        b'a'..=b'z' => c - b'a' + 26,
        b'0'..=b'9' => c - b'0' + 52,
        b'+' => 62,
        _ => 63,
    };
    let letters: Vec<u8> = text.bytes().filter(|c| *c != b'=').map(value).collect();
    let bits = |four: &[u8]| four.iter().enumerate().fold(0u32, |all, (k, v)| all | u32::from(*v) << (18 - 6 * k));
    letters.chunks(4).flat_map(|four| bits(four).to_be_bytes()[1..four.len()].to_vec()).collect()
}
