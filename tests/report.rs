//! The report of a walk, as a browser shows it: light and dark, on a desk and on a phone.

use serde_json::json;

use crate::support::browser::Browser;
use crate::support::{Foveal, folder, scene};

/// Nothing is fetched, nothing sticks out, words can be told from what is behind them, and two pictures lie under one line.
#[test]
fn a_report_is_shown_at_any_size() {
    let Some(browser) = Browser::open() else { return };
    let out = folder("report");
    Foveal::new("walk --quick --frames 12 --fps 60 --size 480x360 --workers 1 --out")
        .arg(&out)
        .arg(scene("box"))
        .ok();
    let mut page = browser.page();
    for (width, scheme) in [(1280, "light"), (1280, "dark"), (390, "light"), (390, "dark")] {
        page.resize(width, 900, scheme, width < 500);
        page.go(&format!("file://{}", out.join("report.html").display()));
        page.wait("document.readyState === 'complete'");
        let what = format!("{width} pixels, {scheme}");
        assert_eq!(page.eval("document.documentElement.scrollWidth <= innerWidth"), json!(true), "{what}");
        // Of each plot there is one, as large as it is drawn for.
        let plots = page.eval(
            "[...document.querySelectorAll('figure.plot')].map(f => [...f.querySelectorAll('svg')]\
             .filter(s => s.getBoundingClientRect().width > 0).length)",
        );
        assert!(
            plots.as_array().is_some_and(|p| p.len() >= 3 && p.iter().all(|n| *n == 1)),
            "{what}: {plots}"
        );
        let contrast = page.eval(
            "(() => { const light = c => { const [r, g, b] = c.match(/[\\d.]+/g).map(v => v / 255)\
             .map(v => v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);\
             return 0.2126 * r + 0.7152 * g + 0.0722 * b; };\
             const back = light(getComputedStyle(document.body).backgroundColor);\
             return Math.min(...[...document.querySelectorAll('h1,h2,p,td,th,figcaption,.name,.value')].map(e => {\
             const c = light(getComputedStyle(e).color);\
             return (Math.max(c, back) + 0.05) / (Math.min(c, back) + 0.05); })); })()",
        );
        assert!(contrast.as_f64().is_some_and(|c| c >= 4.5), "{what}: contrast {contrast}");
    }
    // Where and when it was made.
    let made = page.eval("document.querySelector('h1 + p').textContent");
    assert!(made.as_str().is_some_and(|m| m.starts_with("foveal ") && m.contains(" core")), "{made}");
    // The line moves, and the difference is another picture.
    let seen = page.eval(
        "(() => { const ab = document.querySelector('.ab'), layers = ab.querySelector('.layers');\
         const [under, over] = layers.querySelectorAll('img'), cut = ab.querySelector('.cut');\
         const all = JSON.parse(ab.querySelector('script').textContent);\
         const pick = mode => ab.querySelector(`input[value=${mode}]`).click();\
         const seen = [ab.classList.contains('live'), under.src === ab.dataset.reference, !over.hidden];\
         pick('flip'); seen.push(under.src === all[0].flip && over.hidden && cut.disabled);\
         pick('shown'); seen.push(under.src === all[0].shown);\
         pick('split'); cut.value = 250; cut.dispatchEvent(new Event('input'));\
         seen.push(!over.hidden && layers.style.getPropertyValue('--cut') === '25%');\
         return seen; })()",
    );
    assert_eq!(seen, json!([true, true, true, true, true, true]));
    assert!(page.errors.is_empty(), "{:?}", page.errors);
    let elsewhere: Vec<&String> =
        page.requests.iter().filter(|r| !r.starts_with("file:") && !r.starts_with("data:")).collect();
    assert!(elsewhere.is_empty(), "{elsewhere:?}");
}
