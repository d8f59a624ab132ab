"""Scenario files as data, and the engine and command line that run them: the only place where all parts meet.

spec        a whole scenario file: `sim.scenario` joined with the estimators' own arguments; JSON Schema
footage     rendered images of a run
store       run folders: stages cached by the hash of their inputs, written whole or not at all
engine      simulate -> estimate -> report
cli         the command line
stereo/     scenario files
data/       small input files of the scenarios
"""
