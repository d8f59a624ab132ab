"""What makes seeing hard: disturbances between the world and the grey values, each with a level whose 0 is off.

What is in the world looks the same to both cameras; what is on the windscreen differs between them.

passing     other cars that drive between camera and target      geometry: part of the world
(reflections and moving shadow edges are drawn: `sim.render.surroundings`; motion blur is an average: `sim.render.blur`)
tone        grey values to light and back
windscreen  what dirt, drops and wiper have in common: how far away, how blurred
rain        drops that refract and fall anew, until wiped
wiper       the blade, and when it last passed
dirt        spots that dim and scatter
glare       the sun's veil, bloom and ghosts
contrast    veil and gain that roll over image and time
steps       sudden changes of exposure
chain       `disturbed`: all of them in the order of the light's way, then the sensor (`sim.sensor`)
"""

from sim.realism.chain import Shot, disturbed

__all__ = ["Shot", "disturbed"]
