"""The explorer in a real browser, in a page without a kernel: its numbers read back from the page."""

import itertools
import re

import numpy as np
import pytest
from browser import NO_CHROMIUM, SCREENSHOTS, STATE, listen, violations, wait_until

from vislam_edu import mapping, odometry, simulate, window_slam
from vislam_edu.error_state import RightInvariant
from vislam_edu.noise import Noise
from vislam_edu.plots import style
from vislam_edu.widgets import Explorer

pytestmark = NO_CHROMIUM
NOISE = Noise()
I = 48  # the half-step that the pages begin with: the births of frame 21, after those of four frames before


@pytest.fixture(scope="module")
def drive():
    return simulate.first_steps()


@pytest.fixture(scope="module")
def steps(drive):
    return list(window_slam.run(drive, NOISE))


@pytest.fixture(scope="module")
def explorers(drive, steps):
    invariant = list(window_slam.run(drive, NOISE, RightInvariant()))
    T = drive.true_world_T_imu
    return {
        "joint": Explorer(steps, drive, name="joint", start=21),
        "two": Explorer({"right": steps, "invariant": invariant}, drive, {"invariant": RightInvariant()}, start=21),
        "mapping": Explorer(mapping.run(drive, NOISE, T), drive, world_T_imu=T, name="mapping", start=21),
        "odometry": Explorer(odometry.localize(drive, NOISE, drive.true_landmarks), drive, name="odometry", start=21),
        "pairs": Explorer.from_beliefs(["before", "1 pair fused"], [s.posterior for s in steps[20:22]], drive,
                                       unit="pair fused", frames=[20, 21]),
    }


@pytest.fixture(scope="module")
def folder(explorers, tmp_path_factory):
    """Where the page of each explorer is."""
    folder = tmp_path_factory.mktemp("explorers")
    for name, explorer in explorers.items():
        explorer.save_html(folder / f"{name}.html")
    return folder


@pytest.fixture(scope="module")
def tab(chromium, folder):
    """A tab for test after test: a new one is a new process, which takes longer than most of them."""
    tab = chromium.new_page()
    listen(tab, folder.as_uri())
    return tab


@pytest.fixture
def opened(tab, folder, request):
    """Function that opens the page of an explorer; afterwards nothing has been complained about or asked for."""
    def open_page(name, width=1100, height=760, color_scheme="light", reduced_motion="no-preference"):
        tab.emulate_media(color_scheme=color_scheme, reduced_motion=reduced_motion)
        tab.set_viewport_size({"width": width, "height": height})
        return load(tab, folder, name)

    yield open_page
    SCREENSHOTS.mkdir(exist_ok=True)
    tab.screenshot(path=SCREENSHOTS / f"{request.node.name.translate({ord('['): '_', ord(']'): None})}.png")
    complaints, tab.complaints = tab.complaints, []
    assert complaints == []


def load(page, folder, name):
    page.goto((folder / f"{name}.html").as_uri())
    page.wait_for_function("() => document.querySelector('.vx')?.explorer.state().map.length")
    return page


def state(page):
    return page.locator(".vx").evaluate(STATE)


def press(page, *keys):
    for key in keys:
        page.keyboard.press(key)


def select(page, label, value):
    page.get_by_label(label, exact=True).select_option(str(value))


def click(page, canvas, x, y):
    page.get_by_role("img", name=canvas).first.click(position={"x": x, "y": y})


# --- every view's numbers ---


def test_map_shows_the_landmarks_and_ellipses_of_the_belief(opened, steps):
    shown = state(opened("joint"))["map"][0]
    belief = steps[21].posterior
    assert [one["id"] for one in shown["landmarks"]] == belief.ids.tolist()
    for one, landmark, P in zip(shown["landmarks"], belief.landmarks, belief.landmark_covariance):
        np.testing.assert_allclose(one["m"], landmark[:2], rtol=1e-5)
        np.testing.assert_allclose(one["axes"], np.sqrt(np.linalg.eigvalsh(P[:2, :2])[::-1]), rtol=1e-3)
    np.testing.assert_allclose(shown["pose"][:2], belief.world_T_imu[:2, 3], rtol=1e-5)
    assert shown["before"] == len(belief.ids) - len(steps[21].born)  # the faint outlines
    inset = shown["inset"]
    np.testing.assert_allclose(inset["sigmas"][2], np.sqrt(belief.pose_covariance[5, 5]), rtol=1e-4)
    np.testing.assert_allclose(inset["before"], inset["sigmas"], rtol=1e-5)  # a birth leaves the pose as it is


def test_a_birth_is_a_step_of_its_own(opened, steps):
    """Predicted, updated, born: new landmarks come in the third, which changes nothing else; then the next frame."""
    page = opened("joint")
    page.get_by_label("half-step").focus()
    press(page, "ArrowLeft", "ArrowLeft")
    old, new, seen = steps[21].prior.ids.tolist(), steps[21].born.tolist(), []
    for label in ("frame 21, 2.1 s, predicted", "frame 21, 2.1 s, updated", "frame 21, 2.1 s, born"):
        shown = state(page)
        assert shown["label"] == page.locator(".vx-readout").text_content() == label
        seen.append({one["id"]: one["axes"] for one in shown["map"][0]["landmarks"]})
        words = page.get_by_role("img", name="map").first.get_attribute("aria-label")
        assert words.endswith(f"new: {', '.join(map(str, new))}") == label.endswith("born")
        press(page, "ArrowRight")
    assert state(page)["label"] == "frame 22, 2.2 s, predicted"
    predicted, updated, born = seen
    assert list(predicted) == list(updated) == old
    assert set(born) == {*old, *new}
    assert all(np.prod(updated[j]) < np.prod(predicted[j]) for j in old)
    assert {j: born[j] for j in old} == updated
    press(page, "ArrowLeft", "ArrowLeft")
    inset = state(page)["map"][0]["inset"]
    np.testing.assert_allclose(inset["before"][:2], np.sqrt(np.diag(steps[21].prior.pose_covariance)[:2]), rtol=1e-4)


def test_a_birth_shows_triangulation_alone_inside_its_ellipse(opened, steps, drive):
    """A new landmark's ellipse without the pose's share is the triangulation's, turned into the world."""
    shown = state(opened("joint"))["map"][0]
    belief, axes = steps[21].posterior, {one["id"]: one["axes"] for one in shown["landmarks"]}
    assert sorted(shown["triangulated"]) == [str(j) for j in steps[21].born]
    for j in steps[21].born:
        T = steps[21].posterior.world_T_imu
        at = belief.landmarks[belief.ids == j][0]
        R = (T @ drive.camera.imu_T_cam)[:3, :3]
        C = R @ drive.camera.triangulation_covariance(drive.camera.to_cam(T, at), NOISE.sigma_px) @ R.T
        found = shown["triangulated"][str(j)]
        np.testing.assert_allclose(found, np.sqrt(np.linalg.eigvalsh(C[:2, :2])[::-1]), rtol=0.02)
        assert found[0] <= axes[j][0]
        assert found[1] < axes[j][1]


def test_numbers_of_landmarks_do_not_cover_each_other_and_the_chosen_one_is_there(opened):
    shown = state(opened("joint"))
    numbers = shown["map"][0]["numbers"]
    assert shown["chosen"] == numbers[0]["id"]
    assert len(shown["map"][0]["landmarks"]) / 2 < len(numbers) < len(shown["map"][0]["landmarks"])
    for a, b in itertools.combinations(numbers, 2):
        assert (a["right"] <= b["left"] or b["right"] <= a["left"]
                or a["bottom"] <= b["top"] or b["bottom"] <= a["top"]), (a, b)


@pytest.mark.parametrize("reading", ["correlation", "covariance", "change"])
def test_matrix_has_three_readings(opened, steps, reading):
    page = opened("joint")
    select(page, "matrix", reading)
    shown = state(page)["matrix"][0]
    P, ids, before = steps[21].posterior.covariance, steps[21].posterior.ids, steps[21].prior
    sigma = np.sqrt(np.diag(P))
    values = np.array(shown["values"], float).reshape(P.shape)  # null becomes NaN
    scale = np.outer(sigma, sigma)
    if reading == "correlation":
        np.testing.assert_allclose(values, P / scale, atol=3e-5)
    elif reading == "covariance":
        np.testing.assert_allclose(values / scale, P / scale, atol=3e-5)
    else:
        kept = np.concatenate([np.repeat(np.isin(ids, before.ids), 3), np.ones(6, bool)])
        assert np.isnan(values[~kept]).all()
        assert not kept.all()
        assert not values[np.ix_(kept, kept)].any()  # the birth
        press(page, "Tab", "ArrowLeft")  # the update
        change = P[np.ix_(kept, kept)] - before.covariance
        old = np.sqrt(np.diag(before.covariance))
        values = np.reshape(state(page)["matrix"][0]["values"], change.shape)
        np.testing.assert_allclose(values / np.outer(old, old), change / np.outer(old, old), atol=6e-5)


@pytest.mark.parametrize("reading", ["correlation", "covariance"])
def test_blocks_of_the_chosen_landmark_are_numbers_of_the_matrix(opened, steps, reading):
    page = opened("joint", width=1366, height=768)
    select(page, "matrix", reading)
    shown, belief = state(page)["blocks"], steps[21].posterior
    at = 3 * belief.ids.tolist().index(shown["id"])
    P, sigma = belief.covariance, np.sqrt(np.diag(belief.covariance))
    expected = P / np.outer(sigma, sigma) if reading == "correlation" else P
    columns = [at, at + 1, at + 2, *range(len(P) - 6, len(P))]
    scale = np.outer(sigma[at:at + 3], sigma[columns]) if reading == "covariance" else 1
    np.testing.assert_allclose(np.array(shown["values"]) / scale, expected[at:at + 3, columns] / scale, atol=4e-5)


def test_landmark_through_time_has_its_birth_updates_and_retirement(opened, explorers, steps):
    page = opened("joint")
    gone = int(steps[10].retired[0])
    select(page, "landmark", gone)
    shown = state(page)["landmark"]
    born = next(k for k, step in enumerate(steps) if gone in step.born)
    at = explorers["joint"].histories[0].at
    expected = [[at(born), "born"], [at(10, 0), "retired"]]
    expected += [[at(step.k, 1), "update"] for step in steps
                 if gone in step.innovation.ids[step.innovation.accepted]]
    kept = [event for event in shown["events"] if event[1] != "kept out"]
    assert sorted(kept) == sorted(expected)
    assert shown["axes"] == [None]
    select(page, "landmark", 13)
    row = steps[21].posterior.ids.tolist().index(13)
    sigmas = np.sqrt(np.linalg.eigvalsh(steps[21].posterior.landmark_covariance[row])[::-1])
    np.testing.assert_allclose(state(page)["landmark"]["axes"][0], sigmas, rtol=1e-3)


def test_time_shows_the_chosen_quantity_of_both_runs(opened, explorers):
    page = opened("two")
    for quantity in ("forward error", "heading error", "NEES of the pose"):
        select(page, "below", quantity)
        shown = state(page)["time"]
        for r, history in enumerate(explorers["two"].histories):
            series = history[quantity]
            for key in ("values", "low", "high"):
                assert shown[key][r] == pytest.approx(getattr(series, key)[I], rel=1e-5)
            assert shown["nis"][r] == pytest.approx(history["NIS / landmark"].values[I], rel=1e-5)


def test_sigma_is_a_stair_and_every_prediction_is_inside_the_axis(opened, explorers):
    page = opened("odometry")
    select(page, "below", "forward σ")
    low, high = state(page)["time"]["area"]["range"]
    sigma = explorers["odometry"].histories[0]["forward σ"].values
    assert low <= sigma.min() < sigma.max() <= high
    assert (sigma[2::2] > sigma[3::2]).all()  # up in the prediction, down in the update


def test_image_shows_the_innovation_of_the_chosen_landmark(opened, explorers):
    shown = state(opened("mapping"))["image"][0]
    sight = explorers["mapping"].histories[0].snapshots[I].sight
    assert [one["id"] for one in shown["measured"]] == sight.ids.tolist()
    np.testing.assert_allclose([one["uv"] for one in shown["measured"]], sight.measured[:, :2], rtol=1e-5)
    at = sight.ids.tolist().index(explorers["mapping"].header["landmark"])
    np.testing.assert_allclose(shown["chosen"]["innovation"], (sight.measured - sight.predicted)[at, :2], atol=1e-3)
    np.testing.assert_allclose(shown["chosen"]["S"], sight.covariance[at][[0, 0, 1], [0, 1, 1]], rtol=1e-5)
    assert shown["chosen"]["nis"] == pytest.approx(sight.nis[at], rel=1e-5)


def test_pairs_of_a_loop_closure_step_by_their_labels(opened):
    page = opened("pairs")
    assert state(page)["label"] == "1 pair fused"
    press(page, "Tab", "Home")
    assert (state(page)["label"], state(page)["i"]) == ("before", 0)


# --- what a reader does ---


def test_a_click_on_a_dot_frames_its_rows_and_a_click_on_rows_finds_the_dot(opened, steps):
    page = opened("joint")
    dot = next(one for one in state(page)["map"][0]["landmarks"] if one["id"] == 8)
    click(page, "map", dot["x"], dot["y"])
    shown = state(page)
    row = steps[21].posterior.ids.tolist().index(8)
    assert (shown["chosen"], shown["matrix"][0]["framed"], shown["landmark"]["id"]) == (8, row, 8)
    assert shown["map"][0]["lines"] > 0
    other = 3 * (row + 2) + 1
    place = shown["matrix"][0]["place"]
    click(page, "joint covariance", place["x"] + 5, place["y"] + shown["matrix"][0]["centres"][other])
    assert state(page)["chosen"] == steps[21].posterior.ids[row + 2]


def test_hovering_over_an_entry_names_it(opened, steps):
    page = opened("joint")
    matrix = state(page)["matrix"][0]
    d, centres = matrix["d"], matrix["centres"]
    position = {"x": matrix["place"]["x"] + centres[d - 1], "y": matrix["place"]["y"] + centres[0]}
    page.get_by_role("img", name="joint covariance").hover(position=position)
    P = steps[21].posterior.covariance
    value = P[0, -1] / np.sqrt(P[0, 0] * P[-1, -1])
    first = steps[21].posterior.ids[0]
    assert page.locator(".vx-tip").text_content() == f"landmark {first} x · pose yaw: {value:.2f}"


def test_keyboard_moves_from_every_place_and_a_click_on_time_goes_there(opened):
    page = opened("joint")
    page.get_by_role("img", name="map").first.focus()
    press(page, "ArrowRight", "ArrowRight", "ArrowLeft")
    assert state(page)["i"] == I + 1
    press(page, "PageDown")
    assert state(page)["i"] == I - 9
    press(page, "PageUp", "End")
    assert state(page)["i"] == 129
    press(page, "Home", "ArrowLeft")
    assert state(page)["i"] == 0
    page.get_by_label("half-step").focus()
    press(page, "ArrowRight")
    assert state(page)["i"] == 1
    area = state(page)["time"]["area"]
    click(page, "errors through time", area["x"] + area["w"] * 2.1 / 5.9, 40)
    assert state(page)["label"] == "frame 21, 2.1 s, updated"


def test_play_goes_on_and_pause_stops_at_once(opened):
    page = opened("joint")
    select(page, "speed", 20)
    page.get_by_role("button", name="play (space)").click()
    wait_until(page, lambda: state(page)["i"] > I + 3, "it did not play")
    page.get_by_role("button", name="pause (space)").click()
    stopped = state(page)
    page.wait_for_timeout(300)
    assert state(page) == stopped
    assert not stopped["playing"]
    page.get_by_role("img", name="map").first.focus()
    press(page, " ")
    assert state(page)["playing"]
    press(page, " ")
    assert not state(page)["playing"]


def test_a_held_key_shows_every_half_step(opened):
    page = opened("joint")
    page.evaluate("""() => { const output = document.querySelector('.vx-readout'); window.seen = [];
        new MutationObserver(() => window.seen.push(document.querySelector('.vx').explorer.state().i))
            .observe(output, {childList: true}); }""")
    page.get_by_label("half-step").focus()
    press(page, "Home", *["ArrowRight"] * 60)
    assert page.evaluate("() => window.seen") == list(range(61))


def test_caption_is_read_out_and_says_what_the_half_step_did(opened, explorers):
    page = opened("joint")
    status = page.get_by_role("status")
    assert status.text_content() == explorers["joint"].caption(I)
    page.get_by_label("half-step").focus()
    press(page, "ArrowRight")
    assert status.text_content() == explorers["joint"].caption(I + 1)
    assert "predicted" in status.text_content()


def test_all_controls_have_names(opened):
    page = opened("two")
    names = page.evaluate("""() => [...document.querySelectorAll('.vx button, .vx input, .vx select')].map(
        e => e.ariaLabel || [...(e.labels || [])].map(l => l.textContent).join('')) """)
    assert all(names)
    assert all(page.evaluate("() => [...document.querySelectorAll('.vx canvas')].map(e => e.ariaLabel)"))


def test_the_label_of_each_canvas_says_what_is_shown_now(opened, explorers, steps):
    def labels(name):
        found = opened_page.evaluate("() => [...document.querySelectorAll('.vx canvas')].map(e => e.ariaLabel)")
        return next(label for label in found if label.startswith(name)).replace("\N{MINUS SIGN}", "-")

    opened_page = opened("joint")
    select(opened_page, "landmark", 13)
    opened_page.get_by_label("half-step").focus()
    for belief in (steps[21].posterior, steps[22].prior):
        heading = np.degrees(np.sqrt(belief.pose_covariance[5, 5]))
        x, y = belief.world_T_imu[:2, 3].round(3)
        assert f"car at {x:.3g}, {y:.3g} m, σ " in labels("map")
        assert f"heading {heading:.3g}°; {len(belief.ids)} landmarks" in labels("map")
        assert f"correlation of {len(belief.ids)} landmarks and the pose; landmark 13, " in labels("joint covariance")
        sigma = np.sqrt(np.linalg.eigvalsh(belief.landmark_covariance[belief.ids.tolist().index(13)])[2])
        assert f"landmark 13: σ longest {sigma:.3g} m" in labels("one landmark")
        assert re.search(r"correlation: landmark \d+ -?\d\.\d\d, pose [a-z ]+ -?\d\.\d\d", labels("one landmark"))
        press(opened_page, "ArrowRight")
    select(opened_page, "matrix", "change")
    assert ": change of" in labels("joint covariance")
    opened_page = opened("mapping")
    chosen = state(opened_page)["image"][0]["chosen"]
    verdict = "accepted" if chosen["accepted"] else "kept out"
    assert f"NIS {chosen['nis']:.3g} (4 numbers), {verdict}" in labels("left image")


def test_ellipses_are_enlarged_and_it_zooms_pans_and_follows(opened):
    page = opened("joint")
    before = state(page)["map"][0]
    select(page, "ellipses", 10)
    assert state(page)["map"][0]["magnify"] == 10
    page.get_by_role("button", name="zoom in").click()
    assert state(page)["map"][0]["k"] == pytest.approx(1.5 * before["k"])
    box = page.get_by_role("img", name="map").first.bounding_box()
    shown = state(page)["map"][0]["landmarks"][0]
    page.mouse.move(box["x"] + 20, box["y"] + 200)
    page.mouse.down()
    page.mouse.move(box["x"] + 70, box["y"] + 190, steps=4)
    page.mouse.up()
    moved = state(page)["map"][0]["landmarks"][0]
    assert (moved["x"] - shown["x"], moved["y"] - shown["y"]) == (pytest.approx(50, abs=1), pytest.approx(-10, abs=1))
    page.get_by_label("follow the car").check()
    page.get_by_role("button", name="show the whole map").click()
    page.get_by_label("follow the car").uncheck()
    assert state(page)["map"][0]["k"] == pytest.approx(before["k"])


def test_two_runs_stand_side_by_side_and_move_together(opened, explorers):
    page = opened("two")
    shown = state(page)
    assert [len(shown[view]) for view in ("map", "matrix")] == [2, 2]
    for r in (0, 1):
        pose = explorers["two"].histories[r].snapshots[I].world_T_imu
        np.testing.assert_allclose(shown["map"][r]["pose"][:3], pose[:3, 3], rtol=1e-5, atol=1e-6)
    select(page, "show", 1)
    assert state(page)["map"] != shown["map"]
    assert len(state(page)["map"]) == 1


def test_two_magnified_poses_have_one_scale_in_every_half_step(opened):
    """The larger ellipse is drawn larger; a scale stays, or steps by ten where an ellipse would be a dot."""
    page, halves = opened("two"), []
    for i in range(0, 130, 3):
        page.locator(".vx").evaluate(f"e => e.explorer.go({i})")
        first, second = (one["inset"] for one in state(page)["map"])
        assert (first["half"], first["widen"]) == (second["half"], second["widen"])
        a, b = (np.divide(one["radius"], one["axes"]) for one in (first, second))
        np.testing.assert_allclose(a, b, rtol=1e-6)
        halves.append(first["half"])
        largest = max(2.448 * axis for one in (first, second) for axis in one["axes"])
        assert largest < first["half"]
    steps = {round(abs(np.log10(b / a)), 6) for a, b in itertools.pairwise(halves)}
    assert steps <= {0, 1, 2}
    assert len(set(halves)) <= 2


def test_where_the_pose_is_all_that_is_estimated_it_is_the_large_view(opened, explorers):
    page = opened("odometry", width=1366, height=768)
    shown = state(page)
    assert "inset" not in shown["map"][0]
    sigma = np.sqrt(np.diag(explorers["odometry"].histories[0].snapshots[43].pose_covariance))  # frame 21, no birth
    assert shown["pose"]["sigmas"][2] == pytest.approx(sigma[5], rel=1e-4)
    sizes = [page.get_by_role("img", name=name).first.bounding_box()["height"] for name in ("pose", "map")]
    assert sizes[0] > 1.3 * sizes[1]


# --- screens ---


@pytest.mark.parametrize("name", ["joint", "two", "mapping", "odometry"])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_theme_is_that_of_the_page(opened, name, scheme):
    page = opened(name, color_scheme=scheme)
    assert state(page)["theme"] == scheme
    assert state(page)["colours"]["posterior"] == style.both_themes()[scheme]["posterior"]
    ink = page.evaluate("""() => [...document.querySelectorAll('.vx canvas')].map(canvas => {
        const d = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
        let light = 0, dark = 0;
        for (let i = 0; i < d.length; i += 4) {
            if (d[i + 3] === 255) (d[i] + d[i + 1] + d[i + 2] > 450 ? light++ : dark++);
        }
        return light > 300 || dark > 300; })""")
    assert all(ink)


@pytest.mark.parametrize("ratio", [1, 2])
def test_canvases_are_as_sharp_as_the_screen(chromium, folder, ratio):
    page = chromium.new_page(device_scale_factor=ratio)
    listen(page, folder.as_uri())
    load(page, folder, "joint")
    sizes = page.evaluate("() => [...document.querySelectorAll('.vx canvas')].map(c => c.width / c.clientWidth)")
    assert sizes == pytest.approx([ratio] * len(sizes), rel=0.01)
    assert page.complaints == []
    page.close()


@pytest.mark.parametrize("name", ["joint", "two", "mapping"])
def test_in_a_window_of_800_px_nothing_is_cut_off(opened, name):
    page = opened(name, width=800)
    assert page.evaluate("() => document.documentElement.scrollWidth") <= 800
    boxes = page.evaluate(
        "() => [...document.querySelectorAll('.vx canvas')].map(c => [c.clientWidth, c.clientHeight])")
    assert all(width >= 240 and height >= 150 for width, height in boxes)


def test_reduced_motion_begins_slowly(opened):
    assert opened("joint", reduced_motion="reduce").get_by_label("speed").input_value() == "1"


@pytest.mark.parametrize("colours", ["light", "dark"])
def test_axe_finds_no_violation(opened, colours):
    assert violations(opened("two", color_scheme=colours)) == []
