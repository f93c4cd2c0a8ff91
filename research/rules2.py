import pickle,numpy as np,sys
R=pickle.load(open(sys.argv[1],"rb"))
def loss(r,lam):
    le=np.log([q["err"] for q in r["rows"]]); L=np.log(r["lams"]); x=np.log(lam)
    if x<L[-1]: return float(np.exp(le[-1]-le.min()+.4*(L[-1]-x)))
    return float(np.exp(np.interp(x,L[::-1],le[::-1])-le.min()))
for start in (-4,-3,-2,-1):
  for ev in (.15,.2,.25,.3,.4):
    out=[]
    for r in R:
        k=[i for i,p in enumerate(r["powers"]) if p>=start]; mis=np.array(r["mis"])[k]; pw=np.array(r["powers"])[k]
        most=mis.min()+ev*r["allowed"]; last=int(np.flatnonzero(mis<=most)[-1]); e=pw[last]
        if last+1<len(pw): e+=(most-mis[last])/(mis[last+1]-mis[last])
        out.append(loss(r,np.hypot(r["F"][0],2.0**e*r["F"][1])))
    print("start",start,"ev",ev,"median %.3f p90 %.3f max %.2f"%(np.median(out),np.percentile(out,90),max(out)),np.round(out,2) if ev==.25 else "")
