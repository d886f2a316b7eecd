//! The page in a browser: what it shows, what hands do in it, how it looks.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::converged;
use super::served::Served;
use crate::support::browser::{Browser, Page};
use crate::support::{CHEAP_BAKE, Foveal, folder, root, scene};

/// The picture is exact.
pub const STILL: &str = "document.getElementById('state').textContent.startsWith('exact')";

/// The server's page, in a tab of its own, once the picture is exact.
pub fn opened(browser: &Browser, served: &Served) -> Page {
    let mut page = browser.page();
    page.resize(1280, 800, "dark", false);
    page.go(&served.address());
    page.wait(STILL);
    let first = page.eval("performance.getEntriesByName('first picture')[0].startTime");
    eprintln!("first picture {:.0} ms after the address was opened", first.as_f64().unwrap_or(f64::NAN));
    page
}

/// Pixels of the canvas, RGB.
pub fn pixels(page: &mut Page) -> Vec<u8> {
    let all = page.eval(
        "(() => { const c = document.getElementById('picture');
         return [...c.getContext('2d').getImageData(0, 0, c.width, c.height).data].filter((_, i) => i % 4 < 3) })()",
    );
    all.as_array().expect("pixels").iter().map(|v| v.as_u64().expect("a byte") as u8).collect()
}

/// Waits until something holds.
pub fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let end = Instant::now() + Duration::from_secs(60);
    while !holds() {
        assert!(Instant::now() < end, "never: {what}");
        std::thread::sleep(Duration::from_millis(30));
    }
}

/// Sets a slider as a hand would, to a share of its length.
pub fn slide(page: &mut Page, key: &str, share: f64) {
    page.eval(&format!(
        "(() => {{ const i = document.getElementById('c-{key}'); i.value = {share} * 1000;
         i.dispatchEvent(new Event('input', {{ bubbles: true }})) }})()"
    ));
}

#[test]
fn the_page_shows_each_bit_and_asks_nobody_else() {
    let Some(browser) = Browser::open() else { return };
    let served = Served::start("--refine 0");
    let mut page = opened(&browser, &served);
    assert!(pixels(&mut page) == *converged("").as_raw(), "not what a walk converges to");
    // The token is not in the address any more, nor in anything that was asked for.
    assert_eq!(page.eval("location.hash"), "");
    let own = [format!("http://127.0.0.1:{}/", served.port), format!("ws://127.0.0.1:{}/", served.port)];
    for request in &page.requests {
        assert!(request == "about:blank" || own.iter().any(|own| request.starts_with(own)), "{request}");
    }
    // (The address that is opened is shown with what no server sees.)
    assert!(page.requests.iter().skip(1).all(|r| r.ends_with(&served.token) || !r.contains(&served.token)));
    assert_eq!(page.errors, Vec::<String>::new());
    assert!(page.eval("document.title").as_str().is_some_and(|title| title.ends_with("– foveal")));
}

#[test]
fn every_overlay_is_what_the_walk_paints() {
    let Some(browser) = Browser::open() else { return };
    let served = Served::start("--refine 0");
    let mut page = opened(&browser, &served);
    let plain = pixels(&mut page);
    // Somebody else looks on, who asks the walk itself for its picture.
    let mut other = served.hello(&served.token);
    other.hears("welcome");
    let all = page.eval("[...document.querySelectorAll('input[name=overlay]')].map(i => i.value)");
    let all: Vec<&str> = all.as_array().expect("radio buttons").iter().filter_map(Value::as_str).collect();
    assert_eq!(all.len(), 11, "{all:?}");
    // These are the same in each walk of a view; others tell of how this one went.
    let of_any = ["object ids", "sample level", "mip wanted", "mip given"];
    let mut painted = BTreeSet::new();
    for name in all {
        page.eval(&format!("document.querySelector('input[name=overlay][value=\"{name}\"]').click()"));
        if name == "none" {
            until("overlays leave nothing behind", || pixels(&mut page) == plain);
            continue;
        }
        page.wait("!document.getElementById('legend').hidden");
        page.wait(&format!("document.getElementById('picture').ariaLabel.includes('{name}')"));
        page.wait(STILL);
        until(&format!("{name} is seen as it was painted"), || {
            let kept = image::load_from_memory(&other.keeps()).expect("a picture").to_rgb8();
            pixels(&mut page) == kept.into_raw()
        });
        let shown = pixels(&mut page);
        #[cfg(feature = "window")]
        if of_any.contains(&name) {
            let out = folder("overlay").join("painted.png");
            let view =
                Foveal::new(&format!("view --headless --refine 0 --size 96x64 --baked {CHEAP_BAKE} --set"));
            view.arg(format!("overlay={name}")).arg("--out").arg(&out).arg(scene("box")).ok();
            assert!(
                shown == image::open(out).expect("a picture").to_rgb8().into_raw(),
                "{name} is not the window's"
            );
        }
        painted.insert(shown);
    }
    assert!(painted.len() >= 6, "{} different pictures", painted.len());
}

#[test]
fn without_scripts_there_is_one_picture_for_who_has_the_token() {
    let served = Served::start("--refine 0");
    let mut viewer = served.hello(&served.token);
    viewer.sees(|flags| flags == 3);
    let host = format!("Host: 127.0.0.1:{}", served.port);
    let form = format!("t={}", served.token);
    let (head, picture) = served.post("/still", &host, &form);
    assert!(head.starts_with("HTTP/1.1 200") && head.contains("image/webp"), "{head}");
    assert!(image::load_from_memory(&picture).expect("a picture").to_rgb8() == converged(""));
    for (host, form, status) in [
        ("Host: evil.example", form.as_str(), 403),
        (&host, "t=AAAAAAAAAAAAAAAAAAAAAA", 403),
        (&host, "x", 400),
        (&host, &"x".repeat(1000), 400),
    ] {
        let (head, _) = served.post("/still", host, form);
        assert!(head.starts_with(&format!("HTTP/1.1 {status}")), "{head}");
    }
    assert!(served.get("/still", &host).starts_with("HTTP/1.1 405"));

    let Some(browser) = Browser::open() else { return };
    let mut page = browser.page();
    page.resize(360, 740, "light", false);
    page.call("Emulation.setScriptExecutionDisabled", json!({"value": true}));
    page.go(&served.address());
    page.wait("document.querySelector('noscript form') !== null");
    page.screenshot(&shots().join("without-scripts.png"), "png");
    page.eval(&format!("document.querySelector('noscript input').value = '{}'", served.token));
    page.eval("document.querySelector('noscript button').click()");
    page.wait("document.contentType === 'image/webp' && document.images[0].naturalWidth === 96");
    assert_eq!(page.errors, Vec::<String>::new());
}

#[test]
fn hands_in_the_page_walk_and_the_visit_replays() {
    let Some(browser) = Browser::open() else { return };
    let file = folder("browsed").join("visit.fvl");
    let served = Served::start(&format!("--refine 0 --record {}", file.display()));
    let mut page = opened(&browser, &served);
    let mut seen = vec![pixels(&mut page)];
    let mut changed = |page: &mut Page, what: &str| {
        let before = seen.last().expect("a picture").clone();
        until(&format!("{what} changes the picture"), || pixels(page) != before);
        page.wait(STILL);
        seen.push(pixels(page));
    };
    page.key("KeyD", "d", true);
    std::thread::sleep(Duration::from_millis(150));
    page.key("KeyD", "d", false);
    changed(&mut page, "a key");
    page.mouse("mousePressed", 300.0, 300.0);
    page.mouse("mouseMoved", 360.0, 310.0);
    page.mouse("mouseReleased", 360.0, 310.0);
    changed(&mut page, "the mouse");
    page.resize(360, 740, "light", true);
    page.touch("touchStart", &[[100.0, 150.0]]);
    page.touch("touchMove", &[[150.0, 150.0]]);
    page.touch("touchEnd", &[]);
    changed(&mut page, "a finger");
    page.touch("touchStart", &[[100.0, 200.0], [200.0, 200.0]]);
    page.touch("touchMove", &[[100.0, 140.0], [200.0, 140.0]]);
    std::thread::sleep(Duration::from_millis(150));
    page.touch("touchEnd", &[]);
    changed(&mut page, "two fingers");
    page.resize(1280, 800, "dark", false);
    slide(&mut page, "exposure", 0.4);
    changed(&mut page, "exposure");
    page.eval("document.querySelector('#places button').click()");
    changed(&mut page, "a place");
    page.eval("document.getElementById('insight').open = true");
    page.wait("document.getElementById('facts').innerText.includes('from input to picture')");
    let facts = page.eval("document.getElementById('facts').innerText.replaceAll('\\n', ' ')");
    eprintln!("{}", facts.as_str().unwrap_or_default());
    // A control keeps its keys.
    page.eval("document.getElementById('c-exposure').focus()");
    page.key("KeyW", "w", true);
    page.key("KeyW", "w", false);
    page.eval("document.getElementById('picture').focus()");
    assert_eq!(page.errors, Vec::<String>::new());
    assert_eq!(served.interrupt().code, Some(130));
    let replayed = Foveal::new("replay --verify").arg(&file).json();
    assert_eq!((&replayed["diverged"], &replayed["complete"]), (&json!(null), &json!(true)));
}

#[test]
fn every_control_of_the_page_reaches_the_walk() {
    let Some(browser) = Browser::open() else { return };
    let served = Served::start("");
    let mut page = opened(&browser, &served);
    page.eval("for (const d of document.querySelectorAll('details')) d.open = true");
    // A second one looks on: what the first sets comes to it from the server.
    let mut other = opened(&browser, &served);
    other.eval("for (const d of document.querySelectorAll('details')) d.open = true");
    assert_eq!(other.eval("document.getElementById('c-fps').disabled"), true);
    let read = |page: &mut Page, id: &str| {
        page.eval(&format!(
            "(() => {{ const i = document.getElementById('{id}');
             return i.type === 'checkbox' ? i.checked : i.type === 'range' ? i.getAttribute('aria-valuetext') : i.value }})()"
        ))
    };
    for id in ["c-compresses", "c-waits"] {
        page.eval(&format!("document.getElementById('{id}').click()"));
    }
    let ids =
        page.eval("[...document.querySelectorAll('#controls [id^=c-]:is(input, select)')].map(i => i.id)");
    let ids: Vec<String> = serde_json::from_value(ids).expect("names");
    assert!(ids.len() >= 16, "{ids:?}");
    for id in &ids {
        let is = |page: &mut Page, tag: &str| {
            page.eval(&format!("document.getElementById('{id}').matches('{tag}')"))
        };
        if is(&mut page, "[type=checkbox]") == true {
            continue;
        }
        if is(&mut page, "select") == true {
            page.eval(&format!(
                "(() => {{ const i = document.getElementById('{id}'); i.selectedIndex = (i.selectedIndex + 1) % i.options.length;
                 i.dispatchEvent(new Event('change')) }})()"
            ));
        } else {
            slide(&mut page, id.trim_start_matches("c-"), 0.3);
        }
        let set = read(&mut page, id);
        other.wait(&format!(
            "(() => {{ const i = document.getElementById('{id}');
             return (i.type === 'range' ? i.getAttribute('aria-valuetext') : i.value) === {set} }})()"
        ));
    }
    assert_eq!(page.errors, Vec::<String>::new());
}

#[test]
fn two_viewers_share_a_walk_and_the_wheel() {
    let Some(browser) = Browser::open() else { return };
    let served = Served::start("--refine 0");
    let mut first = opened(&browser, &served);
    let mut second = opened(&browser, &served);
    let text = |id: &str| format!("document.getElementById('{id}').textContent");
    second.wait(&format!("{}.includes('you watch')", text("people")));
    assert_eq!(second.eval("document.getElementById('take').hidden"), false);
    // Whoever drives is asked, since they are at it.
    first.key("KeyA", "a", true);
    first.key("KeyA", "a", false);
    second.eval("document.getElementById('take').click()");
    first.wait("!document.getElementById('asked').hidden");
    first.eval("document.getElementById('give').click()");
    second.wait("document.getElementById('take').hidden");
    first.wait("!document.getElementById('take').hidden");
    // What one does both see.
    let before = pixels(&mut second);
    second.key("KeyD", "d", true);
    std::thread::sleep(Duration::from_millis(120));
    second.key("KeyD", "d", false);
    until("a key changes the picture", || pixels(&mut second) != before);
    second.wait(STILL);
    let both = pixels(&mut second);
    // Only the tab in front is painted, and only to that are frames sent.
    first.call("Page.bringToFront", json!({}));
    until("both see the same", || pixels(&mut first) == both);
    // A page that is loaded again is who it was.
    second.call("Page.bringToFront", json!({}));
    second.call("Page.reload", json!({}));
    second.wait(&format!("document.getElementById('take').hidden && {STILL}"));
    assert!(pixels(&mut second) == both);
}

#[test]
fn a_server_that_ends_and_begins_again_is_found() {
    let Some(browser) = Browser::open() else { return };
    let token = folder("token").join("token");
    let kept = format!("--refine 0 --token-file {}", token.display());
    let first = Served::start(&kept);
    let mut page = opened(&browser, &first);
    let port = first.port;
    assert_eq!(first.interrupt().code, Some(130));
    page.wait("document.getElementById('veil-text').textContent.includes('trying again')");
    let second = Served::start(&format!("{kept} --listen 127.0.0.1:{port}"));
    assert_eq!(second.port, port);
    page.wait(STILL);
    // Without the token there is a word and no picture.
    let mut bare = browser.page();
    bare.go(&format!("http://127.0.0.1:{port}/"));
    bare.wait("document.getElementById('veil-text').textContent.includes('token')");
}

/// Where pictures of the page are left for whoever wants to look.
pub fn shots() -> PathBuf {
    std::env::var_os("FOVEAL_SHOTS").map_or_else(|| folder("shots"), PathBuf::from)
}

#[test]
fn the_page_fits_every_screen_and_names_all_that_can_be_used() {
    let Some(browser) = Browser::open() else { return };
    let served = Served::start("--size 320x240");
    let mut page = opened(&browser, &served);
    for scheme in ["dark", "light"] {
        // (The last is the first at 400 %.)
        for (width, height) in [(1280, 800), (768, 1024), (360, 740), (320, 640), (320, 200)] {
            page.resize(width, height, scheme, width < 700);
            let over = page.eval("document.documentElement.scrollWidth - innerWidth");
            assert!(over.as_f64() <= Some(0.0), "{width}: {over} pixels too wide");
            page.screenshot(&shots().join(format!("{scheme}-{width}.png")), "png");
            low_contrast(&mut page, &format!("{scheme}, {width}"));
        }
    }
    page.eval("for (const d of document.querySelectorAll('details')) d.open = true");
    page.wait("document.querySelectorAll('#actors tbody tr').length > 3");
    for (width, height) in [(1280, 2000), (360, 3200)] {
        page.resize(width, height, "light", width < 700);
        let over = page.eval("document.documentElement.scrollWidth - innerWidth");
        assert!(over.as_f64() <= Some(0.0), "{width}: {over} pixels too wide");
        page.screenshot(&shots().join(format!("open-{width}.png")), "png");
        low_contrast(&mut page, &format!("open, {width}"));
    }
    // Large enough for fingers.
    let small = page.eval(
        "[...document.querySelectorAll('button, select, summary')].filter(b => b.checkVisibility())
         .map(b => [b.textContent.trim(), b.getBoundingClientRect().height]).filter(([, h]) => h < 44)",
    );
    assert_eq!(small, json!([]));
    let tree = page.call("Accessibility.getFullAXTree", json!({}));
    let used = ["button", "slider", "checkbox", "radio", "combobox", "image", "DisclosureTriangle"];
    let mut seen = BTreeSet::new();
    for node in tree["nodes"].as_array().expect("nodes") {
        let role = node["role"]["value"].as_str().unwrap_or_default();
        if used.contains(&role) && node["ignored"] != true {
            let name = node["name"]["value"].as_str().unwrap_or_default();
            assert!(!name.trim().is_empty(), "{role} has no name: {node}");
            seen.insert(role.to_owned());
        }
    }
    assert!(
        ["button", "slider", "checkbox", "radio", "combobox", "image"].iter().all(|r| seen.contains(*r)),
        "{seen:?}"
    );
    // By keyboard alone: everything is reached, in the order that it stands there.
    page.resize(1280, 800, "dark", false);
    page.eval("document.activeElement?.blur(); window.scrollTo(0, 0)");
    let mut order = Vec::new();
    for _ in 0..60 {
        page.press("Tab", 9);
        let at = page.eval("document.activeElement.id || document.activeElement.textContent.trim()");
        if order.contains(&at) && at != "" {
            break;
        }
        order.push(at);
    }
    let find =
        |what: &str| order.iter().position(|at| at == what).unwrap_or_else(|| panic!("{what}: {order:?}"));
    assert!(find("keep") < find("picture") && find("picture") < find("c-exposure"));
    assert!(find("c-exposure") < find("c-policy"));
    // Help comes and goes by a key.
    page.eval("document.getElementById('picture').focus()");
    page.key("F1", "F1", true);
    page.wait("document.getElementById('keys').open");
    page.screenshot(&shots().join("keys.png"), "png");
    assert_eq!(page.errors, Vec::<String>::new());
}

#[test]
fn a_walk_goes_by_keyboard_alone() {
    let Some(browser) = Browser::open() else { return };
    let served = Served::start("--refine 0");
    let mut page = opened(&browser, &served);
    let start = pixels(&mut page);
    let tab_to = |page: &mut Page, id: &str| {
        for _ in 0..80 {
            page.press("Tab", 9);
            if page.eval(&format!("document.activeElement.matches('{id}')")) == true {
                return;
            }
        }
        panic!("{id} is never reached");
    };
    tab_to(&mut page, "#picture");
    page.press("ArrowRight", 39);
    until("an arrow walks", || pixels(&mut page) != start);
    page.wait(STILL);
    // On a control it is the control's.
    tab_to(&mut page, "#c-exposure");
    let (there, stops) = (pixels(&mut page), page.eval("document.getElementById('c-exposure').value"));
    page.press("ArrowLeft", 37);
    assert_ne!(page.eval("document.getElementById('c-exposure').value"), stops);
    until("a slider goes by arrows", || pixels(&mut page) != there);
    page.wait(STILL);
    tab_to(&mut page, "#scene > summary");
    page.press("Enter", 13);
    page.wait("document.getElementById('scene').open");
    tab_to(&mut page, "#size");
    tab_to(&mut page, "#lamp-0");
    let lit = pixels(&mut page);
    page.press("ArrowLeft", 37);
    until("a lamp goes by arrows", || pixels(&mut page) != lit);
    assert_eq!(page.errors, Vec::<String>::new());
}

#[test]
#[ignore = "writes the pictures of the book"]
fn pictures_of_the_page() {
    let Some(browser) = Browser::open() else { return };
    let served = Served::of(&scene("gallery"), "--size 640x480 --baked --refine-samples 16");
    let pictures = root().join("docs/src/pictures");
    let mut page = browser.page();
    page.resize(1280, 800, "dark", false);
    page.go(&served.address());
    page.wait("document.getElementById('state').textContent === 'exact, refined'");
    page.eval("document.getElementById('insight').open = true");
    page.screenshot(&pictures.join("serve.jpg"), "jpeg");
    page.resize(390, 844, "light", true);
    page.eval("document.querySelector('input[value=saliency]').click()");
    page.wait("!document.getElementById('legend').hidden");
    page.wait(STILL);
    std::thread::sleep(Duration::from_secs(1));
    page.screenshot(&pictures.join("serve-phone.jpg"), "jpeg");
}

/// `cargo test --release --test program -- --ignored figures_of_the_page --nocapture`
#[test]
#[ignore = "tells times, optimised"]
fn figures_of_the_page() {
    let Some(browser) = Browser::open() else { return };
    for paints in [true, false] {
        let served = Served::start("--size 512x512 --fps 30 --refine 0");
        let mut page = browser.page();
        if !paints {
            // Waiting until the screen takes its next picture is none of the door's work.
            let source = "window.requestAnimationFrame = f => { queueMicrotask(f); return 0 }";
            page.call("Page.addScriptToEvaluateOnNewDocument", json!({"source": source}));
        }
        page.resize(1280, 800, "dark", false);
        page.go(&served.address());
        page.wait(STILL);
        let of = |page: &mut Page, what: &str| page.eval(what).as_f64().unwrap_or(f64::NAN);
        let shown = of(&mut page, "performance.getEntriesByName('first-contentful-paint')[0].startTime");
        let first = of(&mut page, "performance.getEntriesByName('first picture')[0].startTime");
        println!("page shown after {shown:.0} ms, first picture after {first:.0} ms");
        for i in 0..60 {
            let x = 300.0 + f64::from(i % 2) * 40.0;
            page.mouse("mousePressed", x, 300.0);
            page.mouse("mouseMoved", x + 20.0, 300.0);
            page.mouse("mouseReleased", x + 20.0, 300.0);
            page.wait(&format!("document.getElementById('picture').latencies.length > {}", i.min(58)));
            page.wait(STILL);
        }
        for (part, what) in ["input → canvas", "the door's own part"].into_iter().enumerate() {
            let latencies = format!("document.getElementById('picture').latencies.map(both => both[{part}])");
            let mut all: Vec<f64> = serde_json::from_value(page.eval(&latencies)).expect("times");
            all.sort_by(f64::total_cmp);
            let [median, p95] = [all.len() / 2, all.len() * 95 / 100].map(|i| all[i]);
            let how = if paints { "with the screen's next picture" } else { "painted at once" };
            println!("{what}, {how}: median {median:.1} ms, p95 {p95:.1} ms");
        }
    }
}

/// Fails where text stands out too little from what is behind it.
fn low_contrast(page: &mut Page, what: &str) {
    let found: Value = page.eval(
        r"(() => {
        const numbers = (c) => c.match(/[\d.]+/g).map(Number);
        const over = ([r, g, b, a = 1], under) => [r, g, b].map((v, i) => v * a + under[i] * (1 - a));
        const light = (c) => { const [r, g, b] = c.map(v => (v /= 255) <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
          return 0.2126 * r + 0.7152 * g + 0.0722 * b };
        const behind = (e) => { if (!e) return [255, 255, 255];
          const c = numbers(getComputedStyle(e).backgroundColor);
          return c[3] === 0 ? behind(e.parentElement) : c[3] === undefined ? c : over(c, behind(e.parentElement)) };
        const poor = [];
        for (const e of document.body.querySelectorAll('*')) {
          const own = [...e.childNodes].some(n => n.nodeType === 3 && n.textContent.trim());
          if (!own || !e.checkVisibility() || e.closest(':disabled, noscript, dialog:not([open])') || e.closest('.skip')) continue;
          const under = behind(e);
          const [a, b] = [light(over(numbers(getComputedStyle(e).color), under)), light(under)].sort((x, y) => y - x);
          const ratio = (a + 0.05) / (b + 0.05);
          if (ratio < 4.5) poor.push([e.tagName, e.textContent.slice(0, 20), ratio.toFixed(2)]);
        }
        return poor })()",
    );
    assert_eq!(found, json!([]), "{what}");
}
