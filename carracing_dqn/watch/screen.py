# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""The watch in a terminal."""
from __future__ import annotations

from typing import Any

from rich.console import Group
from rich.text import Text
from textual.app import App, ComposeResult
from textual.binding import Binding
from textual.containers import Container, Horizontal, VerticalScroll
from textual.events import Resize
from textual.widgets import Footer, Input, Static

from bags.playback import next_rate, SKIP_SECONDS
from carracing_dqn.watch import painting
from carracing_dqn.watch.commands import BAG_COMMANDS, COMMANDS
from carracing_dqn.watch.source import Source
from msgs_bridge.errors import BridgeError

SHOW_SECONDS = 0.4
# from this size on everything is on one screen
WIDE, HIGH = 120, 38
# lines of what is wrong, on a small screen and on one with room
CAUSE_LINES, MANY_LINES = 6, 10
# more than all that is wrong can need
ALL_LINES = 1000
EPSILON_STEP = 0.05
PANES = ('drive', 'nodes', 'topics', 'plots')
ALL_COMMANDS = {*COMMANDS, *BAG_COMMANDS}


class Screen(App[None]):
    """Shows a source some times a second; keys act on it."""

    TITLE = 'carracing watch'
    ENABLE_COMMAND_PALETTE = False
    AUTO_FOCUS = None
    CSS = """
    #head { height: 1; background: $primary-background; padding: 0 1; }
    #causes { height: auto; padding: 0 1; border-left: thick $error; }
    #causes.good { border-left: thick $success; }
    #notice { height: 1; padding: 0 1; color: $text-muted; }
    #drive { height: 1fr; }
    #picture { width: 1fr; height: 100%; padding: 0 1; }
    #values { width: 40; height: 100%; }
    .pane { display: none; padding: 0 1; }
    .shown { display: block; }
    #panes.all { layout: grid; grid-size: 2 2; grid-rows: 2fr 1fr; }
    #panes.all .pane { display: block; border: round $primary-background; }
    #find { display: none; dock: bottom; }
    """
    BINDINGS = [
        Binding('q', 'quit', 'quit'),
        Binding('space', 'pause', 'pause'),
        Binding('s', 'send("step")', 'step'),
        Binding('r', 'send("reset")', 'reset'),
        Binding('e', 'enable', 'on/off'),
        Binding('plus,equals_sign', 'epsilon(1)', 'epsilon', key_display='+ -'),
        Binding('minus', 'epsilon(-1)', 'epsilon', show=False),
        Binding('left', 'skip(-1)', 'back', show=False),
        Binding('right', 'skip(1)', 'on', show=False),
        Binding('left_square_bracket', 'rate(-1)', 'slower', show=False),
        Binding('right_square_bracket', 'rate(1)', 'faster', show=False),
        Binding('c', 'car', 'car', show=False),
        Binding('slash', 'find', 'plot'),
        *(Binding(str(number), f'pane("{name}")', name, show=False)
          for number, name in enumerate(PANES, 1)),
    ]

    def __init__(self, source: Source) -> None:
        """Show a source; `run` blocks until the user quits."""
        super().__init__()
        self._source = source
        self._pane = PANES[0]
        self._plots: list[str] = []
        self._car: str | None = None
        self._shown: dict[str, Any] = {}

    def compose(self) -> ComposeResult:
        """Lay out the parts."""
        yield Static(id='head')
        yield Static(id='causes')
        with Container(id='panes'):
            with Horizontal(id='drive', classes='pane'):
                yield Static(id='picture')
                yield Static(id='values')
            for name in PANES[1:]:
                with VerticalScroll(id=name, classes='pane'):
                    yield Static(id=f'{name}-text')
        yield Static(id='notice')
        # disabled it takes no key
        yield Input(placeholder='part of a name to plot, such as q. or speed', id='find',
                    disabled=True)
        yield Footer()

    def on_mount(self) -> None:
        """Begin to show."""
        self.action_pane(self._pane)
        self.set_interval(SHOW_SECONDS, self.show)
        self.show()

    def on_resize(self, event: Resize) -> None:
        """Show everything at once where there is room."""
        self.query_one('#panes').set_class(
            event.size.width >= WIDE and event.size.height >= HIGH, 'all')

    def show(self) -> None:
        """Take what is known now and show it."""
        if not self.query('#head'):
            # the timer's last call may come when the parts are gone
            return
        source = self._source
        shown = self._shown = source.state.snapshot(source.now(), self._car, self._plots)
        everything = self.query_one('#panes').has_class('all')
        self._put('head', _head(shown))
        self._put('causes', painting.causes(
            shown, self.size.width - 4, MANY_LINES if everything else CAUSE_LINES))
        self.query_one('#causes').set_class(not shown['causes'], 'good')
        self._put('notice', self._tabs(shown['notice'], everything))
        if everything or self._pane == 'drive':
            area = self.query_one('#picture').content_size
            self._put('picture', painting.picture(
                source.state.pixels(self._car), area.width, area.height))
            self._put('values', painting.drive(shown))
        if everything or self._pane == 'nodes':
            width = self.query_one('#nodes').content_size.width
            self._put('nodes-text', Group(
                painting.nodes(shown), Text(), painting.causes(shown, width, ALL_LINES)))
        if everything or self._pane == 'topics':
            self._put('topics-text', painting.topics(shown))
        if everything or self._pane == 'plots':
            width = self.query_one('#plots').content_size.width
            self._put('plots-text', painting.plots(shown, width))

    def _put(self, name: str, what: Any) -> None:
        self.query_one(f'#{name}', Static).update(what)

    def _tabs(self, notice: str, everything: bool) -> Text:
        """Return the views with their keys where they are shown one at a time, and the notice."""
        text = Text(no_wrap=True)
        for number, name in enumerate(() if everything else PANES, 1):
            text.append(f'{number} {name}', 'reverse' if name == self._pane else '')
            text.append('  ')
        return text.append(notice)

    # --- keys

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool:
        """Return whether a key does anything with this source; the others are not shown."""
        command = parameters[0] if action == 'send' else action
        return command not in ALL_COMMANDS or command in self._source.commands

    def action_send(self, name: str, value: Any = None) -> None:
        """Do something by name."""
        try:
            self._source.act(name, value, self._shown.get('namespace'))
        except BridgeError as error:
            self._source.state.say(str(error))

    def action_pause(self) -> None:
        """Pause, or go on."""
        self.action_send('pause', not self._shown['switches'].get('paused'))

    def action_enable(self) -> None:
        """Disable the policy, or enable it."""
        self.action_send('enable', self._shown['switches'].get('enabled') is False)

    def action_epsilon(self, sign: int) -> None:
        """Explore more or less."""
        epsilon = self._shown['switches'].get('epsilon') or 0.0
        self.action_send('epsilon', round(min(1.0, max(0.0, epsilon + sign * EPSILON_STEP)), 4))

    def action_skip(self, sign: int) -> None:
        """Wind a bag."""
        self.action_send('skip', sign * SKIP_SECONDS)

    def action_rate(self, sign: int) -> None:
        """Play a bag faster or slower."""
        self.action_send('rate', next_rate(self._shown['playing'].get('rate', 1.0), sign))

    def action_car(self) -> None:
        """Show the next car."""
        cars = self._shown['cars']
        if cars:
            at = cars.index(self._car) if self._car in cars else 0
            self._car = cars[(at + 1) % len(cars)]

    def action_pane(self, name: str) -> None:
        """Show one part, on a screen that has no room for all."""
        self._pane = name
        for pane in PANES:
            self.query_one(f'#{pane}').set_class(pane == name, 'shown')

    def action_find(self) -> None:
        """Ask what to plot."""
        find = self.query_one('#find', Input)
        find.disabled = False
        find.styles.display = 'block'
        find.focus()

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Plot what has a part of its name; nothing typed: the choice of the start."""
        wanted = event.value.strip()
        self._plots = [name for name in self._shown['series'] if wanted in name] if wanted else []
        event.input.disabled = True
        event.input.styles.display = 'none'
        self.action_pane('plots')
        self.set_focus(None)


def _head(shown: dict[str, Any]) -> Text:
    text = Text(shown['title'])
    if shown['namespace']:
        text.append(f'  {shown["namespace"]}')
    playing, switches = shown['playing'], shown['switches']
    if playing:
        text.append(f'  {playing["position"]:.1f} of {playing["duration"]:.1f} s, '
                    f'x{playing["rate"]:g}  (arrows wind, [ ] speed)')
    if switches.get('paused'):
        text.append('  paused', 'yellow')
    if switches.get('enabled') is False:
        text.append('  disabled', 'yellow')
    if switches.get('epsilon') is not None:
        text.append(f'  epsilon {switches["epsilon"]:g}')
    if len(shown['cars']) > 1:
        text.append(f'  car {shown["namespace"] or "/"} of {len(shown["cars"])} (c)')
    if shown['rejected']:
        text.append(f'  {shown["rejected"]} messages refused', 'yellow')
    return text
