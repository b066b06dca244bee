"""Experiments that answered a question once. They use both packages; neither package uses them."""
