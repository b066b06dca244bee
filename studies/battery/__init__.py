"""The hidden battery: is it worth seeing what the opponent has spent, when its energy is hidden?"""
