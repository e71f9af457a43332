# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""A bag that is watched: wound and stepped, in a terminal, and as a page in a real browser."""
import asyncio
import contextlib
import http.client
import json
import shutil
import socket
import time

from bag_cases import record_drive
from bags.errors import BagError
from carracing_dqn.watch.bag_source import BagSource
from carracing_dqn.watch import page as page_module
from carracing_dqn.watch.page import MAX_BODY, MAX_CONNECTIONS, MAX_STREAMS, Page
from carracing_dqn.watch.screen import Screen
from graph_probe import carracing, wait_for
from msgs_bridge.errors import BridgeError
import pytest

CHROMIUM = shutil.which('chromium') or shutil.which('chromium-browser')
TWO_SIZES = [(1200, 900), (390, 844)]


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    folder = tmp_path_factory.mktemp('watched') / 'bag'
    record_drive(folder, episodes=2, decisions=60)
    return folder


@pytest.fixture
def source(bag):
    source = BagSource(bag, paused=True)
    wait_for(lambda: shown(source)['picture'], 10, 'the first picture')
    yield source
    source.close()


@pytest.fixture
def page(source):
    page = Page(source, 0)
    yield page
    page.close()


def shown(source):
    return source.state.snapshot(source.now())


def stamp(source):
    return shown(source)['picture']['stamp']


def ask(page, method, path, body=None, **headers):
    place = page.url.removeprefix('http://').rstrip('/')
    connection = http.client.HTTPConnection(place, timeout=10)
    try:
        headers = {name.replace('_', '-'): value for name, value in headers.items()}
        connection.request(method, path, body, headers)
        answer = connection.getresponse()
        return answer.status, answer.read(), answer.headers
    finally:
        connection.close()


def test_it_steps_from_image_to_image_and_is_wound(source):
    first = stamp(source)
    source.act('step')
    wait_for(lambda: stamp(source) > first, 5, 'the next picture')
    second = stamp(source)
    source.act('seek', shown(source)['playing']['duration'] / 2)
    wait_for(lambda: stamp(source) > second + 0.2, 5, 'the middle')
    source.act('seek', 0.0)
    wait_for(lambda: shown(source)['picture'] and stamp(source) == first, 5, 'the beginning')
    source.act('rate', 0.01)
    source.act('pause', False)
    wait_for(lambda: not shown(source)['playing']['paused'], 5, 'playing')
    assert stamp(source) < first + 0.5
    source.act('rate', 20.0)
    wait_for(lambda: shown(source)['notice'] == 'the end of the bag', 20, 'the end')
    assert {'episode_return', 'speed'} <= shown(source)['plots'].keys()
    assert shown(source)['rejected'] == 0
    # it goes on from its beginning
    source.act('rate', 0.01)
    wait_for(lambda: stamp(source) > first + 0.5, 5, 'the last picture')
    source.act('pause', False)
    wait_for(lambda: shown(source)['picture'] and stamp(source) < first + 0.5, 5, 'once more')
    assert shown(source)['notice'] == 'playing' and not shown(source)['playing']['paused']


@pytest.mark.parametrize('error', [
    BagError('chunk 3 is damaged'), OSError(5, 'Input/output error'), IndexError('odd')])
def test_why_a_bag_ends_before_its_end_is_said(source, monkeypatch, error):
    messages = source._reader.messages

    def damaged(*arguments):
        for number, message in enumerate(messages(*arguments)):
            if number == 30:
                raise error
            yield message

    monkeypatch.setattr(source._reader, 'messages', damaged)
    source.act('rate', 100.0)
    source.act('seek', 0.0)
    source.act('pause', False)
    why = str(error) if isinstance(error, BagError) else repr(error)
    wait_for(lambda: shown(source)['notice'] == why, 10, 'why')
    # what is whole is shown all the same
    monkeypatch.setattr(source._reader, 'messages', messages)
    source.act('pause', False)
    wait_for(lambda: shown(source)['notice'] == 'the end of the bag', 20, 'the end')


@pytest.mark.parametrize(('name', 'value'), [
    ('fly', None), ('pause', 1), ('pause', 'x' * 1000), ('seek', float('nan')), ('rate', 0),
    ('skip', True), ('seek', None), ('epsilon', 0.5)])
def test_a_command_that_is_none_is_refused_in_a_line(source, name, value):
    with pytest.raises(BridgeError) as caught:
        source.act(name, value)
    assert len(str(caught.value)) < 300 and '\n' not in str(caught.value)


def test_what_is_no_bag_is_refused(tmp_path):
    with pytest.raises(BagError, match='does not exist'):
        BagSource(tmp_path / 'nothing')
    said = carracing('watch', str(tmp_path / 'nothing'), '--json', '1')
    assert said.returncode == 2 and said.stderr.startswith('error: ')
    assert said.stderr.count('\n') == 1


@pytest.mark.parametrize(('words', 'told'), [
    (['--browser', '--json', '1'], 'leave one of them out'),
    (['--json', '1', '--port', '8080'], '--port is that of the page'),
    (['--json', '1', '--paused'], '--paused is for a bag'),
])
def test_what_would_have_no_effect_is_refused(words, told):
    said = carracing('watch', *words)
    assert said.returncode == 2 and told in said.stderr and said.stderr.count('\n') == 1


def test_the_command_prints_what_it_sees_as_json(bag):
    said = carracing('watch', str(bag), '--json', '2')
    assert said.returncode == 0, said.stderr
    assert json.loads(said.stdout)['drive']['speed'] is not None


def test_a_screen_without_a_terminal_says_what_there_is(bag):
    said = carracing('watch', str(bag))
    assert said.returncode == 2 and '--browser' in said.stderr


@pytest.mark.parametrize('size', [(80, 24), (140, 44)])
def test_the_screen_shows_it_and_keys_act(source, size):
    async def look():
        screen = Screen(source)
        async with screen.run_test(size=size) as pilot:
            for key in ('2', '3', 'c', 'e', 'plus', 's', 'space', 'right'):
                await pilot.press(key)
                await pilot.pause(0.05)
            await pilot.press('slash', *'speed', 'enter')
            await pilot.pause(0.3)
            text = screen.export_screenshot()
            await pilot.press('1')
            await pilot.pause(0.4)
            return text, screen.export_screenshot()

    plots, drive = asyncio.run(look())
    assert not shown(source)['playing']['paused'] or shown(source)['notice']
    assert 'speed' in plots and (size[0] > 80 or 'episode_return' not in plots)
    assert '▀' in drive and 'left' in drive


def test_the_page_is_for_this_machine_and_its_own_pages_alone(page):
    assert page.url.startswith('http://127.0.0.1:')
    host = page.url.removeprefix('http://').rstrip('/')
    assert ask(page, 'GET', '/')[0] == 200
    assert ask(page, 'GET', '/', Host=f'localhost:{host.partition(":")[2]}')[0] == 200
    for other in ('evil.example', f'evil.example:{host.partition(":")[2]}', '127.0.0.1', ''):
        assert ask(page, 'GET', '/', Host=other)[0] == 403
        assert ask(page, 'GET', '/events', Host=other)[0] == 403
    for path in ('/x', '/../setup.py', '/page.html', '/page.css/../page.py'):
        assert ask(page, 'GET', path)[0] == 404, path
    policy = ask(page, 'GET', '/')[2]['Content-Security-Policy']
    assert "default-src 'none'" in policy and 'http' not in policy
    for path in ('/', '/page.js', '/page.css'):
        assert b'http:' not in ask(page, 'GET', path)[1]
        assert b'//cdn' not in ask(page, 'GET', path)[1]


def test_commands_by_post_are_checked(page, source):
    def post(body, **headers):
        headers = {'Content_Type': 'application/json', **headers}
        return ask(page, 'POST', '/act', body, **headers)[0]

    wish = json.dumps({'name': 'pause', 'value': False})
    assert post(wish, Origin='http://evil.example') == 403
    assert post(wish, Content_Type='text/plain') == 403
    assert post(wish, Host='evil.example') == 403
    assert shown(source)['playing']['paused']
    for bad in ('', '{', '[]', '1', '{"name": 1}', '{"name": "pause", "namespace": 3}',
                '{"value": 1}', 'x' * (MAX_BODY + 1), '[' * 1000):
        assert post(bad) == 400, bad[:20]
    assert ask(page, 'POST', '/act', json.dumps({'name': 'fly'}),
               Content_Type='application/json')[:2] == (
        400, b"no command 'fly'; there are pause, step, seek, skip, rate")
    assert post(wish, Origin=page.url.rstrip('/')) == 204
    wait_for(lambda: not shown(source)['playing']['paused'], 5, 'playing')


def test_streams_are_bounded_and_end_with_the_page(page):
    place = page.url.removeprefix('http://').rstrip('/')
    streams = []
    for _ in range(MAX_STREAMS):
        stream = http.client.HTTPConnection(place, timeout=10)
        stream.request('GET', '/events?plot=speed&car=nobody')
        streams.append(stream.getresponse())
        line = streams[-1].readline()
        assert json.loads(line.removeprefix(b'data: '))['picture']['data'].startswith('data:')
    assert ask(page, 'GET', '/events')[0] == 503
    streams.pop().close()
    # one that has gone gives its place to the next
    wait_for(lambda: _opens(place), 10, 'a place')


def test_many_or_slow_connections_keep_nobody_out_for_long(page, monkeypatch):
    monkeypatch.setattr(page_module, 'SOCKET_SECONDS', 3.0)
    host, _, port = page.url.removeprefix('http://').rstrip('/').partition(':')
    slow = [socket.create_connection((host, int(port)), timeout=20)
            for _ in range(MAX_CONNECTIONS + 9)]
    most, until = 0, time.monotonic() + 5.0
    try:
        while time.monotonic() < until:
            most = max(most, len(page._server.ends_at))
            # a byte now and then is no request
            for one in slow:
                with contextlib.suppress(OSError):
                    one.send(b'G')
            time.sleep(0.1)
        wait_for(lambda: not page._server.ends_at, 5, 'that they are cut')
        assert MAX_CONNECTIONS / 2 < most <= MAX_CONNECTIONS
        assert ask(page, 'GET', '/')[0] == 200
    finally:
        for one in slow:
            one.close()


def test_a_picture_that_goes_meanwhile_does_not_end_a_stream(page, source, monkeypatch):
    monkeypatch.setattr(source.state, 'pixels', lambda *_: None)
    place = page.url.removeprefix('http://').rstrip('/')
    stream = http.client.HTTPConnection(place, timeout=10)
    stream.request('GET', '/events')
    answer = stream.getresponse()
    for _ in range(2):
        line = answer.readline()
        assert 'data' not in json.loads(line.removeprefix(b'data: '))['picture']
        answer.readline()
    stream.close()


def _opens(place):
    stream = http.client.HTTPConnection(place, timeout=10)
    stream.request('GET', '/events')
    return stream.getresponse().status == 200


def test_a_port_that_is_taken_is_one_line(page, source):
    with pytest.raises(BridgeError, match='--port'):
        Page(source, int(page.url.rstrip('/').rpartition(':')[2]))


@pytest.fixture(scope='module')
def browser():
    playwright = pytest.importorskip(
        'playwright.sync_api', reason="no playwright: pip install '.[browser]'")
    if CHROMIUM is None:
        pytest.skip('no chromium on the path')
    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=CHROMIUM, args=['--no-sandbox'])
        yield browser
        browser.close()


def holds(tab, expression):
    wait_for(lambda: tab.evaluate(expression), 10, expression)


@pytest.mark.parametrize('size', TWO_SIZES)
def test_the_page_in_a_browser(browser, page, source, size):
    said = []
    tab = browser.new_page(viewport={'width': size[0], 'height': size[1]})
    tab.on('console', lambda message: said.append(message.text))
    tab.on('pageerror', lambda error: said.append(str(error)))
    tab.on('request', lambda one: said.append(one.url) if not one.url.startswith(
        (page.url, 'data:')) else None)
    tab.goto(page.url)
    holds(tab, "document.querySelector('#picture').naturalWidth == 96")
    tab.wait_for_selector('.action.chosen')
    tab.wait_for_selector('.plot canvas')
    # nothing is wider than the screen
    assert tab.evaluate('document.documentElement.scrollWidth') <= size[0]
    assert 'nothing that can be seen' in tab.inner_text('#causes')
    # what only a live graph has is not offered
    assert tab.is_visible('#pause') and not tab.is_visible('#enable')
    before = stamp(source)
    tab.click('button[data-act=step]')
    wait_for(lambda: stamp(source) > before, 5, 'a step')
    tab.click('#pause')
    wait_for(lambda: not shown(source)['playing']['paused'], 5, 'playing')
    holds(tab, "document.querySelector('#pause').textContent == 'pause'")
    tab.evaluate("""() => { const seek = document.querySelector('#seek');
        seek.value = 0; seek.dispatchEvent(new Event('change')); }""")
    tab.select_option('#more', 'tiles_visited')
    holds(tab, "document.querySelector('#plots').textContent.includes('tiles_visited')")
    assert not [line for line in said if 'favicon' not in line], said
    tab.close()


def test_texts_from_outside_are_no_markup_in_the_browser(browser, page, source):
    source.state.title = '<img src=x onerror=alert(1)>'
    tab = browser.new_page()
    asked = []
    tab.on('dialog', lambda dialog: asked.append(dialog.message))
    tab.goto(page.url)
    holds(tab, "document.querySelector('#title').textContent.includes('<img')")
    time.sleep(0.3)
    assert not asked and tab.locator('header img').count() == 0
    tab.close()
